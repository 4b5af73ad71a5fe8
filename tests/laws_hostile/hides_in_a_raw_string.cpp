// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: harmless
// gate: text
// A raw string, in which a comment seems to begin.
#include <lithe/law.hpp>
// clang-format off
struct Hostile {
  struct Params {};
  struct State {};
  static constexpr const char* kText = R"x(*/ " // )x";
  static void step(const lithe::Tick&, const Params&, State&, lithe::Effort& u) { u.torque_nm[0] = kText[0] * 1e-3; }
};
// clang-format on
LITHE_LAW(Hostile, "hides_in_a_raw_string");
