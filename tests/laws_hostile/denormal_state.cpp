// SPDX-License-Identifier: Apache-2.0
// stopped-by: none
// without-gates: harmless
// A filter that decays into denormal numbers: slow, but within the budget.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {
    double x = 1e-290;
  };

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    for (std::uint32_t j = 0; j < t.joints; ++j) {
      u.torque_nm[j] = 4 * (t.setpoint_position_rad[j] - t.position_rad[j]) - 0.1 * t.velocity_rad_s[j];
    }
    s.x *= 0.5;
    u.torque_nm[0] += s.x;
  }
};
LITHE_LAW(Hostile, "denormal_state");
