// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: unplaceable
// gate: includes
// Names what it includes through a macro.
#include <lithe/law.hpp>
#define WHAT <unistd.h>
#include WHAT

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) { usleep(1); }
};
LITHE_LAW(Hostile, "include_through_macro");
