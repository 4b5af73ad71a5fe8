// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: illegal_instruction
// gate: calls
// Aborts.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    if (t.joints > 0) std::abort();
  }
};
LITHE_LAW(Hostile, "aborts");
