// SPDX-License-Identifier: Apache-2.0
// stopped-by: trial
// without-gates: arithmetic
// An integer division by zero, when the joint is at rest.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    const int v = static_cast<int>(t.velocity_rad_s[0] * 1000);
    u.torque_nm[0] = 1e-3 * (1000 / v);
  }
};
LITHE_LAW(Hostile, "divides_by_zero");
