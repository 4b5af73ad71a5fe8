// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: bad_access
// gate: words
// Jumps to a computed address.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    void* volatile where = (void*)8;
    if (t.joints > 0) goto* where;
  }
};
LITHE_LAW(Hostile, "computed_goto");
