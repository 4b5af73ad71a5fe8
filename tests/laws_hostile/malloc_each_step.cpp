// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: unplaceable
// gate: calls
// Allocates the C way.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    auto* x = static_cast<double*>(std::malloc(8 * t.joints));
    x[0] = t.position_rad[0];
    u.torque_nm[0] = x[t.tick % t.joints];
    std::free(x);
  }
};
LITHE_LAW(Hostile, "malloc_each_step");
