// SPDX-License-Identifier: Apache-2.0
// PD plus gravity feed-forward of an arm that hangs down at zero: torque = mgl sin(q) + kp (q* - q) + kd (dq* - dq).
// Gravity pulls a point mass m on a massless rod l with m g l sin(q); with more joints each carries its own pendulum.
// Params: mgl_nm measured gravity torque at 90 degrees (0 = plain PD), kp_nm_rad, kd_nm_s_rad.
#include <lithe/law.hpp>

struct GravityPd {
  struct Params {
    lithe::Param mgl_nm{0.0, -50.0, 50.0};
    lithe::Param kp_nm_rad{4.0, 0.0, 200.0};
    lithe::Param kd_nm_s_rad{0.1, 0.0, 20.0};
  };
  struct State {};
  struct Probes {
    double gravity_nm = 0;  // of the first joint
  };

  static void step(const lithe::Tick& t, const Params& p, State&, lithe::Effort& u, Probes& probes) {
    for (std::uint32_t j = 0; j < t.joints; ++j) {
      u.torque_nm[j] = p.mgl_nm * std::sin(t.position_rad[j]) +
                       p.kp_nm_rad * (t.setpoint_position_rad[j] - t.position_rad[j]) +
                       p.kd_nm_s_rad * (t.setpoint_velocity_rad_s[j] - t.velocity_rad_s[j]);
    }
    probes.gravity_nm = p.mgl_nm * std::sin(t.position_rad[0]);
  }
};
LITHE_LAW(GravityPd, "gravity_pd");
