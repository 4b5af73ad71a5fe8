// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: harmless
// gate: words
// Looks at a double as an integer through a pointer.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    u.torque_nm[0] = 1e-30 * double(*reinterpret_cast<const long*>(&t.position_rad[0]) & 7);
  }
};
LITHE_LAW(Hostile, "reinterprets");
