// SPDX-License-Identifier: Apache-2.0
// Holds each joint where it was when the law took over: torque = kp (q0 - q) - kd dq. Ignores the plan.
// Params: kp_nm_rad stiffness, kd_nm_s_rad damping, one pair for all joints.
#include <lithe/law.hpp>

struct Hold {
  struct Params {
    lithe::Param kp_nm_rad{4.0, 0.0, 200.0};
    lithe::Param kd_nm_s_rad{0.1, 0.0, 20.0};
  };
  struct State {
    bool holding = false;
    lithe::JointArray hold_position_rad{};
  };

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    if (!s.holding) {
      s.hold_position_rad = t.position_rad;
      s.holding = true;
    }
    for (std::uint32_t j = 0; j < t.joints; ++j)
      u.torque_nm[j] = p.kp_nm_rad * (s.hold_position_rad[j] - t.position_rad[j]) - p.kd_nm_s_rad * t.velocity_rad_s[j];
  }
};
LITHE_LAW(Hold, "hold");
