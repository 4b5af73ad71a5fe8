// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: unplaceable
// gate: words
// Remembers in a thread-local variable.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    thread_local double last_rad = 0;
    u.torque_nm[0] = last_rad;
    last_rad = t.position_rad[0];
  }
};
LITHE_LAW(Hostile, "thread_local_variable");
