// SPDX-License-Identifier: Apache-2.0
// stopped-by: containment
// without-gates: arithmetic
// Works for twenty seconds, then divides by zero.
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
    volatile int zero = 0;
    u.torque_nm[0] = 7 / zero;  // 1 / zero would be no division: the compiler knows its only two results
  }
};
LITHE_LAW(Hostile, "divides_delayed");
