// SPDX-License-Identifier: Apache-2.0
// stopped-by: admission
// without-gates: bad_access
// gate: stack
// Calls an address it made up.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    auto f = (double (*volatile)(double))(t.tick * 4096 + 8);
    u.torque_nm[0] = f(1);
  }
};
LITHE_LAW(Hostile, "jumps_to_an_address");
