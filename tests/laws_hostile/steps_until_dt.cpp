// SPDX-License-Identifier: Apache-2.0
// stopped-by: trial
// without-gates: harmless
// A loop that ends when the time has passed, which a zero dt never lets it.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    double left = 1e-3;
    while (left > 0) left -= t.dt_s;
    u.torque_nm[0] = -0.01 * t.position_rad[0] + left;
  }
};
LITHE_LAW(Hostile, "steps_until_dt");
