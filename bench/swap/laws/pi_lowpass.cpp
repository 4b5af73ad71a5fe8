// SPDX-License-Identifier: Apache-2.0
// PI with a low-pass on the measured velocity: torque = kp e + integral + kd (dq* - filtered dq). The integral carries
// the arm's weight. After a law without an integral, it starts from the torque that held the arm during the last ticks.
#include <lithe/law.hpp>

struct PiLowpass {
  struct Params {
    lithe::Param kp_nm_rad{4.0, 0.0, 40.0};
    lithe::Param ki_nm_rad_s{20.0, 0.0, 200.0};
    lithe::Param kd_nm_s_rad{0.1, 0.0, 2.0};
    lithe::Param filter_s{0.004, 0.0, 0.1};
  };
  struct State {
    lithe::JointArray integral_nm{};
    lithe::JointArray velocity_rad_s{};
  };

  static double blend(const Params& p, double dt_s) { return dt_s / (p.filter_s + dt_s); }

  static void init(const lithe::History& past, const Params& p, State& s) {
    const std::uint32_t count = std::min(past.count, 200u), recent = std::min(count, 20u);
    for (std::uint32_t j = 0; j < past.joints; ++j) {
      for (std::uint32_t i = count; i-- > 0;) {
        const lithe::PastTick& was = past[i];
        s.velocity_rad_s[j] += blend(p, past.dt_s) * (was.velocity_rad_s[j] - s.velocity_rad_s[j]);
        if (i >= recent) continue;
        const double rest_nm = p.kp_nm_rad * (was.setpoint_position_rad[j] - was.position_rad[j]) +
                               p.kd_nm_s_rad * (was.setpoint_velocity_rad_s[j] - s.velocity_rad_s[j]);
        s.integral_nm[j] += (was.command_torque_nm[j] - rest_nm) / recent;
      }
    }
  }

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    for (std::uint32_t j = 0; j < t.joints; ++j) {
      const double error_rad = t.setpoint_position_rad[j] - t.position_rad[j];
      s.integral_nm[j] = std::clamp(s.integral_nm[j] + p.ki_nm_rad_s * error_rad * t.dt_s, -0.5, 0.5);
      s.velocity_rad_s[j] += blend(p, t.dt_s) * (t.velocity_rad_s[j] - s.velocity_rad_s[j]);
      u.torque_nm[j] = p.kp_nm_rad * error_rad + s.integral_nm[j] +
                       p.kd_nm_s_rad * (t.setpoint_velocity_rad_s[j] - s.velocity_rad_s[j]);
    }
  }
};
LITHE_LAW(PiLowpass, "pi_lowpass");
