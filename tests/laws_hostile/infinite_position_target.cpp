// SPDX-License-Identifier: Apache-2.0
// stopped-by: trial
// without-gates: not_finite
// Asks the drive for an infinite position.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    u.position_rad[0] = 1e308 * 10 * (1 + t.t_s);
    u.kp_nm_rad[0] = 1;
  }
};
LITHE_LAW(Hostile, "infinite_position_target");
