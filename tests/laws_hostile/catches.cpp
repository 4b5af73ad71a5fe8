// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: uncompilable
// gate: words
// Tries and catches.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    try {
      u.torque_nm[0] = 1;
    } catch (...) {
    }
  }
};
LITHE_LAW(Hostile, "catches");
