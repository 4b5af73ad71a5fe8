// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: harmless
// gate: words
// Rewrites its own input.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    const_cast<lithe::Tick&>(t).position_rad[0] = 0;
    u.torque_nm[0] = 0;
  }
};
LITHE_LAW(Hostile, "casts_away_const");
