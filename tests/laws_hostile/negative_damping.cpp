// SPDX-License-Identifier: Apache-2.0
// stopped-by: trial
// without-gates: clamp
// The sign of the damping is wrong: it swings ever wider.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    for (std::uint32_t j = 0; j < t.joints; ++j)
      u.torque_nm[j] = 2 * (t.setpoint_position_rad[j] - t.position_rad[j]) + 0.3 * t.velocity_rad_s[j];
  }
};
LITHE_LAW(Hostile, "negative_damping");
