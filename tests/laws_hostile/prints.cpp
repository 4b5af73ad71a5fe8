// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: unplaceable
// gate: includes
// Prints from the tick.
#include <cstdio>
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    std::printf("%f\n", t.position_rad[0]);
  }
};
LITHE_LAW(Hostile, "prints");
