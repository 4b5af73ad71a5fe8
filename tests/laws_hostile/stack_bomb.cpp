// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: bad_access
// gate: stack
// Sixteen megabytes on the stack.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    volatile double big[2'000'000];
    big[t.tick % 2'000'000] = t.position_rad[0];
    u.torque_nm[0] = big[t.tick % 2'000'000] * 1e-3;
  }
};
LITHE_LAW(Hostile, "stack_bomb");
