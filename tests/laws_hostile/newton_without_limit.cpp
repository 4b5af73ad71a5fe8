// SPDX-License-Identifier: Apache-2.0
// stopped-by: trial
// without-gates: harmless
// Iterates until it converges, which NaN never does.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    double x = 1;
    while (!(std::fabs(x * x - 2 - std::fabs(t.position_rad[0])) < 1e-9))
      x = 0.5 * (x + (2 + std::fabs(t.position_rad[0])) / x);
    u.torque_nm[0] = 1e-3 * x;
  }
};
LITHE_LAW(Hostile, "newton_without_limit");
