// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: harmless
// gate: words
// The time of compilation decides what it does.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    u.torque_nm[0] = __TIME__[7] * 1e-4;
  }
};
LITHE_LAW(Hostile, "stamps_the_time");
