// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: unplaceable
// gate: includes
// An include that does not look like one.
#include <lithe/law.hpp>
%:include <unistd.h>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) { usleep(1); }
};
LITHE_LAW(Hostile, "include_by_digraph");
