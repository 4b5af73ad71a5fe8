// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: unplaceable
// gate: memory
// A global that is computed when the law is loaded.
#include <lithe/law.hpp>

double computed(int i) { return std::sin(i * std::sqrt(2.0 + i)); }
std::array<double, 8> table = {computed(1), computed(2), computed(3)};

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    u.torque_nm[0] = 1e-3 * table[t.tick % 8];
  }
};
LITHE_LAW(Hostile, "global_with_constructor");
