// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: harmless
// gate: preprocessor
// The word asm, glued together by the preprocessor.
#include <lithe/law.hpp>

#define GLUE(a, b) a##b

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) { GLUE(as, m) volatile("nop"); }
};
LITHE_LAW(Hostile, "asm_glued");
