// SPDX-License-Identifier: Apache-2.0
// stopped-by: trial
// without-gates: harmless
// Rewrites its input through an old-style cast.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    ((lithe::Tick&)t).position_rad[0] = 0;
    u.torque_nm[0] = 0;
  }
};
LITHE_LAW(Hostile, "writes_its_input");
