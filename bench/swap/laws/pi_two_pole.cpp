// SPDX-License-Identifier: Apache-2.0
// PI with two low-passes in series on the velocity: less noise than pi_lowpass, and another structure. The integral has
// the same name as there and is carried; the filters are new, and init() runs them on the last ticks.
#include <lithe/law.hpp>

struct PiTwoPole {
  struct Params {
    lithe::Param kp_nm_rad{4.0, 0.0, 40.0};
    lithe::Param ki_nm_rad_s{20.0, 0.0, 200.0};
    lithe::Param kd_nm_s_rad{0.1, 0.0, 2.0};
    lithe::Param filter_s{0.002, 0.0, 0.1};
  };
  struct State {
    lithe::JointArray integral_nm{};
    lithe::JointArray first_rad_s{};
    lithe::JointArray second_rad_s{};
  };

  static void filter(const Params& p, State& s, std::uint32_t j, double velocity_rad_s, double dt_s) {
    const double share = dt_s / (p.filter_s + dt_s);
    s.first_rad_s[j] += share * (velocity_rad_s - s.first_rad_s[j]);
    s.second_rad_s[j] += share * (s.first_rad_s[j] - s.second_rad_s[j]);
  }

  static void init(const lithe::History& past, const Params& p, State& s) {
    const std::uint32_t count = std::min(past.count, 200u), recent = std::min(count, 20u);
    for (std::uint32_t j = 0; j < past.joints; ++j) {
      for (std::uint32_t i = count; i-- > 0;) {
        const lithe::PastTick& was = past[i];
        filter(p, s, j, was.velocity_rad_s[j], past.dt_s);
        if (i >= recent) continue;
        const double rest_nm = p.kp_nm_rad * (was.setpoint_position_rad[j] - was.position_rad[j]) +
                               p.kd_nm_s_rad * (was.setpoint_velocity_rad_s[j] - s.second_rad_s[j]);
        s.integral_nm[j] += (was.command_torque_nm[j] - rest_nm) / recent;
      }
    }
  }

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    for (std::uint32_t j = 0; j < t.joints; ++j) {
      const double error_rad = t.setpoint_position_rad[j] - t.position_rad[j];
      s.integral_nm[j] = std::clamp(s.integral_nm[j] + p.ki_nm_rad_s * error_rad * t.dt_s, -0.5, 0.5);
      filter(p, s, j, t.velocity_rad_s[j], t.dt_s);
      u.torque_nm[j] = p.kp_nm_rad * error_rad + s.integral_nm[j] +
                       p.kd_nm_s_rad * (t.setpoint_velocity_rad_s[j] - s.second_rad_s[j]);
    }
  }
};
LITHE_LAW(PiTwoPole, "pi_two_pole");
