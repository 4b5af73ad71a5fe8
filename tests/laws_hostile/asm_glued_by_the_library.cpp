// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: harmless
// gate: words
// The word asm, glued together by a macro of the C library.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    __CONCAT(as, m) volatile("nop");
  }
};
LITHE_LAW(Hostile, "asm_glued_by_the_library");
