// SPDX-License-Identifier: Apache-2.0
// stopped-by: trial
// without-gates: overran
// Never returns.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    for (volatile int x = 1; x != 0;) x = 1;
  }
};
LITHE_LAW(Hostile, "loops_for_ever");
