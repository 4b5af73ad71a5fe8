// SPDX-License-Identifier: Apache-2.0
// Reflex: a PD to the setpoint, until a sensor reaches its threshold. In the same tick, faster than any plan, every
// joint moves back against its direction of motion, by withdraw_rad from its position at the touch. hold_s after the
// last touch it follows the setpoint again. A sensor that is not valid (NaN) triggers nothing. Params: kp, kd of the
// PD; sensor is the number of the [[sensor]] in the robot file, from 0; threshold in its unit.
#include <lithe/law.hpp>

struct Reflex {
  struct Params {
    lithe::Param kp_nm_rad{2.0, 0.0, 200.0};
    lithe::Param kd_nm_s_rad{0.05, 0.0, 20.0};
    lithe::Param sensor{0, 0, lithe::kMaxSensors - 1};
    lithe::Param threshold{0.5, -1e6, 1e6};
    lithe::Param withdraw_rad{0.2, 0.0, 1.0};
    lithe::Param hold_s{0.5, 0.0, 10.0};
  };
  struct State {
    double reflex_left_s = 0;  // 0: it follows the setpoint
    std::array<double, lithe::kMaxJoints> retreat_rad{};
  };
  struct Probes {
    double reflex_left_s = 0;
  };

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u, Probes& probe) {
    const double felt = t.sensor[static_cast<std::size_t>(p.sensor)];
    const bool touched = felt >= p.threshold;  // false for NaN
    const bool begins = touched && s.reflex_left_s <= 0;
    s.reflex_left_s = touched ? p.hold_s + t.dt_s : std::max(0.0, s.reflex_left_s - t.dt_s);
    for (std::uint32_t j = 0; j < t.joints; ++j) {
      const double going = t.setpoint_velocity_rad_s[j] != 0 ? t.setpoint_velocity_rad_s[j] : t.velocity_rad_s[j];
      if (begins) s.retreat_rad[j] = t.position_rad[j] - (going == 0 ? 0 : std::copysign(p.withdraw_rad, going));
      const bool away = s.reflex_left_s > 0;
      u.torque_nm[j] = p.kp_nm_rad * ((away ? s.retreat_rad[j] : t.setpoint_position_rad[j]) - t.position_rad[j]) +
                       p.kd_nm_s_rad * ((away ? 0.0 : t.setpoint_velocity_rad_s[j]) - t.velocity_rad_s[j]);
    }
    probe.reflex_left_s = s.reflex_left_s;
  }
};
LITHE_LAW(Reflex, "reflex");
