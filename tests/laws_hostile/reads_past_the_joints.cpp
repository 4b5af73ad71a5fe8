// SPDX-License-Identifier: Apache-2.0
// stopped-by: trial
// without-gates: harmless
// Takes the setpoint of the next joint: the last one has none.
#include <lithe/law.hpp>

struct Hostile {
  struct Params {};
  struct State {};

  static void step(const lithe::Tick& t, const Params&, State&, lithe::Effort& u) {
    for (std::uint32_t j = 0; j < t.joints; ++j) {
      u.torque_nm[j] = 0.5 * (t.setpoint_position_rad[j + 1] - t.position_rad[j]) - 0.05 * t.velocity_rad_s[j];
    }
  }
};
LITHE_LAW(Hostile, "reads_past_the_joints");
