// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: bad_access
// gate: stack
// Recursion as deep as the tick count.
#include <lithe/law.hpp>

double down(const lithe::Tick& t, int n) {
  volatile double here = t.position_rad[static_cast<std::size_t>(n) % 8];
  if (n <= 0) return here;
  const double below = down(t, n - 1);
  return here + below;
}

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    u.torque_nm[0] = 1e-9 * down(t, 1'000'000 + static_cast<int>(t.joints));
  }
};
LITHE_LAW(Hostile, "deep_recursion");
