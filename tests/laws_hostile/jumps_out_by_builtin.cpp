// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: bad_access
// gate: words
// Leaves the step by the compiler's own longjmp.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    void* place[5] = {};
    if (t.joints > 0) __builtin_longjmp(place, 1);
  }
};
LITHE_LAW(Hostile, "jumps_out_by_builtin");
