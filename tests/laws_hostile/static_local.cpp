// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: unplaceable
// gate: memory
// Remembers the last error in a static variable.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    static double last_rad = 0;
    u.torque_nm[0] = t.position_rad[0] - last_rad;
    last_rad = t.position_rad[0];
  }
};
LITHE_LAW(Hostile, "static_local");
