// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: uncompilable
// gate: words
// Throws when a joint is far away.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    if (t.position_rad[0] > 1) throw 1;
  }
};
LITHE_LAW(Hostile, "throws");
