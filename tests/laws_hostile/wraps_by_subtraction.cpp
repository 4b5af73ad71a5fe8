// SPDX-License-Identifier: Apache-2.0
// stopped-by: trial
// without-gates: harmless
// Wraps an angle by subtracting turns: 1e300 rad takes for ever.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    double a = t.position_rad[0];
    while (a > 3.2) a -= 6.4;
    while (a < -3.2) a += 6.4;
    u.torque_nm[0] = -0.1 * a;
  }
};
LITHE_LAW(Hostile, "wraps_by_subtraction");
