// SPDX-License-Identifier: Apache-2.0
// stopped-by: guard
// without-gates: clamp
// Works for twenty seconds, then asks the drive for an impossible stiffness.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {
    std::uint32_t steps = 0;
  };

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    if (++s.steps < 20'000) {
      for (std::uint32_t j = 0; j < t.joints; ++j) {
        u.torque_nm[j] = 4 * (t.setpoint_position_rad[j] - t.position_rad[j]) - 0.1 * t.velocity_rad_s[j];
      }
      return;
    }
    u.position_rad[0] = t.position_rad[0] + 1;
    u.kp_nm_rad[0] = 1e6;
  }
};
LITHE_LAW(Hostile, "stiffens_delayed");
