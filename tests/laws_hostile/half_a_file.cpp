// SPDX-License-Identifier: Apache-2.0
// stopped-by: compile
// without-gates: uncompilable
// The text ends in the middle, as when an answer was cut off.
#include <lithe/law.hpp>
struct Hostile {
  struct Params {};
  struct State {};
  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    u.torque_nm[0] = 4 * (t.setpoint_position
