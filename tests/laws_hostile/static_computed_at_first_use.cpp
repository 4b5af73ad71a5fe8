// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: unplaceable
// gate: memory
// A static variable that is computed at its first use.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    static const double first_rad = t.position_rad[0];
    u.torque_nm[0] = first_rad - t.position_rad[0];
  }
};
LITHE_LAW(Hostile, "static_computed_at_first_use");
