// SPDX-License-Identifier: Apache-2.0
// A law that its trial refuses for the last of the hostile inputs: it is compiled, placed and tried like one that is
// accepted, but nothing is staged in the Spine. So it costs the other cores what a swap costs them.
#include <lithe/law.hpp>

struct RefusedLast {
  struct Params {
    lithe::Param kp_nm_rad{4.0, 0.0, 40.0};
    lithe::Param kd_nm_s_rad{0.1, 0.0, 2.0};
  };
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State&, lithe::Effort& u) {
    for (std::uint32_t j = 0; j < t.joints; ++j) {
      u.torque_nm[j] = p.kp_nm_rad * (t.setpoint_position_rad[j] - t.position_rad[j]) +
                       p.kd_nm_s_rad * (t.setpoint_velocity_rad_s[j] - t.velocity_rad_s[j]);
    }
    if (t.tick != ~0ull) return;
    double late = 0;  // longer than the budget of a step
    for (int i = 0; i < 1'000'000; ++i) late = 0.5 * late + t.position_rad[0];
    u.torque_nm[0] += 1e-9 * late;
  }
};
LITHE_LAW(RefusedLast, "refused_last");
