// SPDX-License-Identifier: Apache-2.0
// PI whose velocity comes from a tracker of the position (alpha-beta filter) and not from the drive. The integral has
// the name it has in pi_lowpass and is carried over; the tracker is new there, and runs through the past to be warm.
#include <lithe/law.hpp>

struct PiTracker {
  struct Params {
    lithe::Param kp_nm_rad{4.0, 0.0, 40.0};
    lithe::Param ki_nm_rad_s{20.0, 0.0, 200.0};
    lithe::Param kd_nm_s_rad{0.1, 0.0, 2.0};
    lithe::Param alpha{0.2, 0.0, 1.0};
    lithe::Param beta{0.02, 0.0, 1.0};
  };
  struct State {
    lithe::JointArray integral_nm{};
    lithe::JointArray tracked_position_rad{};
    lithe::JointArray tracked_velocity_rad_s{};
  };

  static void track(const Params& p, State& s, std::uint32_t j, double position_rad, double dt_s) {
    s.tracked_position_rad[j] += s.tracked_velocity_rad_s[j] * dt_s;
    const double off_rad = position_rad - s.tracked_position_rad[j];
    s.tracked_position_rad[j] += p.alpha * off_rad;
    s.tracked_velocity_rad_s[j] += p.beta / dt_s * off_rad;
  }

  static void init(const lithe::History& past, const Params& p, State& s) {
    const std::uint32_t count = std::min(past.count, 500u), recent = std::min(count, 20u);
    for (std::uint32_t j = 0; j < past.joints && count > 0; ++j) {
      s.tracked_position_rad[j] = past[count - 1].position_rad[j];
      s.tracked_velocity_rad_s[j] = past[count - 1].velocity_rad_s[j];
      for (std::uint32_t i = count; i-- > 0;) {
        const lithe::PastTick& was = past[i];
        track(p, s, j, was.position_rad[j], past.dt_s);
        if (i >= recent) continue;
        const double rest_nm = p.kp_nm_rad * (was.setpoint_position_rad[j] - was.position_rad[j]) +
                               p.kd_nm_s_rad * (was.setpoint_velocity_rad_s[j] - s.tracked_velocity_rad_s[j]);
        s.integral_nm[j] += (was.command_torque_nm[j] - rest_nm) / recent;
      }
    }
  }

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    for (std::uint32_t j = 0; j < t.joints; ++j) {
      const double error_rad = t.setpoint_position_rad[j] - t.position_rad[j];
      s.integral_nm[j] = std::clamp(s.integral_nm[j] + p.ki_nm_rad_s * error_rad * t.dt_s, -0.5, 0.5);
      track(p, s, j, t.position_rad[j], t.dt_s);
      u.torque_nm[j] = p.kp_nm_rad * error_rad + s.integral_nm[j] +
                       p.kd_nm_s_rad * (t.setpoint_velocity_rad_s[j] - s.tracked_velocity_rad_s[j]);
    }
  }
};
LITHE_LAW(PiTracker, "pi_tracker");
