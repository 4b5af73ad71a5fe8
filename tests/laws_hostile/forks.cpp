// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: unplaceable
// gate: calls
// Copies the process that ticks.
#include <lithe/law.hpp>

int fork();

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) { u.torque_nm[0] = fork(); }
};
LITHE_LAW(Hostile, "forks");
