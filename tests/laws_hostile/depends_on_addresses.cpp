// SPDX-License-Identifier: Apache-2.0
// stopped-by: trial
// without-gates: harmless
// Its output depends on where its memory lies.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {
    double a = 0;
  };

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    u.torque_nm[0] = 1e-9 * double(((unsigned long)&s >> 12) & 0xffff);
  }
};
LITHE_LAW(Hostile, "depends_on_addresses");
