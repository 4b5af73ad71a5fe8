// SPDX-License-Identifier: Apache-2.0
// Joint PD with velocity reference: torque = kp (q* - q) + kd (dq* - dq). The usual tracking law.
// Params: kp_nm_rad stiffness, kd_nm_s_rad damping, one pair for all joints.
#include <lithe/law.hpp>

struct Pd {
  struct Params {
    lithe::Param kp_nm_rad{4.0, 0.0, 200.0};
    lithe::Param kd_nm_s_rad{0.1, 0.0, 20.0};
  };
  struct State {};

  static void step(const lithe::Tick& t, const Params& p, State&, lithe::Effort& u) {
    for (std::uint32_t j = 0; j < t.joints; ++j) {
      u.torque_nm[j] = p.kp_nm_rad * (t.setpoint_position_rad[j] - t.position_rad[j]) +
                       p.kd_nm_s_rad * (t.setpoint_velocity_rad_s[j] - t.velocity_rad_s[j]);
    }
  }
};
LITHE_LAW(Pd, "pd");
