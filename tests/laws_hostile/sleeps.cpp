// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: unplaceable
// gate: words
// Waits a millisecond in each step.
#include <lithe/law.hpp>

int usleep(unsigned);

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) { usleep(1000); }
};
LITHE_LAW(Hostile, "sleeps");
