// SPDX-License-Identifier: Apache-2.0
// stopped-by: compile
// without-gates: uncompilable
// A step that takes other arguments than the contract's.
#include <lithe/law.hpp>
struct Hostile {
  struct Params {};
  struct State {};
  static double step(double error_rad) { return 4 * error_rad; }
};
LITHE_LAW(Hostile, "step_with_other_arguments");
