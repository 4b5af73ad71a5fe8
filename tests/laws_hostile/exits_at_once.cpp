// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: unplaceable
// gate: calls
// Ends the process without a word.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    if (t.joints > 0) std::quick_exit(0);
  }
};
LITHE_LAW(Hostile, "exits_at_once");
