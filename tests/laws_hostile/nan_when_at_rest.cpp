// SPDX-License-Identifier: Apache-2.0
// stopped-by: trial
// without-gates: not_finite
// Divides by the velocity.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    u.torque_nm[0] = 1e-3 * (t.velocity_rad_s[0] - t.velocity_rad_s[0]) / (t.velocity_rad_s[0] - t.velocity_rad_s[0]);
  }
};
LITHE_LAW(Hostile, "nan_when_at_rest");
