// SPDX-License-Identifier: Apache-2.0
// stopped-by: containment
// without-gates: overran
// Works for twenty seconds, then takes ten milliseconds a step.
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
    volatile double x = 0;
    for (int i = 0; i < 10'000'000; ++i) x = x + 1e-9;
    u.torque_nm[0] = x;
  }
};
LITHE_LAW(Hostile, "slow_delayed");
