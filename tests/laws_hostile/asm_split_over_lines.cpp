// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: harmless
// gate: words
// The word asm, hidden by joined lines.
#include <lithe/law.hpp>
// clang-format off
struct Hostile {
  struct Params {};
  struct State {};
  static void step(const lithe::Tick&, const Params&, State&, lithe::Effort&) {
    as\
m volatile("nop");
  }
};
// clang-format on
LITHE_LAW(Hostile, "asm_split_over_lines");
