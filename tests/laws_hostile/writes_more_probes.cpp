// SPDX-License-Identifier: Apache-2.0
// stopped-by: trial
// without-gates: harmless
// Writes more probes than it declared.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};
  struct Probes {
    double a = 0;
  };

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u, Probes& probes) {
    for (int i = 0; i < 12; ++i) ((volatile double*)&probes)[i] = 1;
    u.torque_nm[0] = probes.a;
  }
};
LITHE_LAW(Hostile, "writes_more_probes");
