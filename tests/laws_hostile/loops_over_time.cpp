// SPDX-License-Identifier: Apache-2.0
// stopped-by: trial
// without-gates: harmless
// Integrates in fixed small steps over dt, however long dt is.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {
    double sum = 0;
  };

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    for (double x = 0; x < t.dt_s; x += 1e-6) s.sum += 1e-6 * t.position_rad[0];
    u.torque_nm[0] = -s.sum;
  }
};
LITHE_LAW(Hostile, "loops_over_time");
