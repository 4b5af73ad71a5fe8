// SPDX-License-Identifier: Apache-2.0
// stopped-by: trial
// without-gates: overran
// Its init never returns.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {
    double x = 0;
  };

  static void init(const lithe::History&, const Params&, State& s) {
    for (volatile int x = 1; x != 0;) x = 1;
    s.x = 1;
  }

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    for (std::uint32_t j = 0; j < t.joints; ++j) {
      u.torque_nm[j] = 4 * (t.setpoint_position_rad[j] - t.position_rad[j]) - 0.1 * t.velocity_rad_s[j];
    }
  }
};
LITHE_LAW(Hostile, "init_loops_for_ever");
