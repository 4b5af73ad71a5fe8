// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: uncompilable
// gate: includes
// Leaves the step by longjmp.
#include <csetjmp>
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    std::jmp_buf place;
    if (setjmp(place) == 0) std::longjmp(place, 1);
  }
};
LITHE_LAW(Hostile, "jumps_out");
