// SPDX-License-Identifier: Apache-2.0
// stopped-by: compile
// without-gates: uncompilable
// A law without a step.
#include <lithe/law.hpp>
struct Hostile {
  struct Params {};
  struct State {};
};
LITHE_LAW(Hostile, "no_step");
