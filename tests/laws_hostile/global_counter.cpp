// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: unplaceable
// gate: memory
// Counts in a global variable.
#include <lithe/law.hpp>

int counted = 0;

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    u.torque_nm[0] = 1e-6 * ++counted;
  }
};
LITHE_LAW(Hostile, "global_counter");
