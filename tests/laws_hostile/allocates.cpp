// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: unplaceable
// gate: words
// Allocates at every step and never gives back.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    double* x = new double[1000];
    for (int i = 0; i < 1000; ++i) x[i] = t.position_rad[0];
    u.torque_nm[0] = x[t.tick % 1000];
  }
};
LITHE_LAW(Hostile, "allocates");
