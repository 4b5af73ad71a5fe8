// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: unplaceable
// gate: calls
// Signals its own process.
#include <lithe/law.hpp>

int raise(int);

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) { u.torque_nm[0] = raise(9); }
};
LITHE_LAW(Hostile, "sends_a_signal");
