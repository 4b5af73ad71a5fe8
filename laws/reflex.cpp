// SPDX-License-Identifier: Apache-2.0
// Reflex: a PD to the setpoint, until a sensor reaches its threshold. In the same tick, faster than any plan, every
// joint goes back towards where it came from: to its position behind a low-pass of back_s, which a moving joint passed
// about back_s ago. It has been there, so this is inside its limits. hold_s after the last touch it follows the
// setpoint again. A sensor that is not valid (NaN) triggers nothing. Params: kp, kd of the PD; sensor is the number of
// the [[sensor]] in the robot file, from 0 (-1: none); threshold in its unit.
#include <lithe/law.hpp>

struct Reflex {
  struct Params {
    lithe::Param kp_nm_rad{2.0, 0.0, 200.0};
    lithe::Param kd_nm_s_rad{0.05, 0.0, 20.0};
    lithe::Param sensor{-1, -1, lithe::kMaxSensors - 1};
    lithe::Param threshold{0.5, -1e6, 1e6};
    lithe::Param back_s{0.2, 0.01, 2.0};
    lithe::Param hold_s{0.5, 0.0, 10.0};
  };
  struct State {
    double reflex_left_s = 0;  // 0: it follows the setpoint
    std::uint32_t ticks = 0;
    std::array<double, lithe::kMaxJoints> behind_rad{};
  };
  struct Probes {
    double reflex_left_s = 0;
  };

  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u, Probes& probe) {
    const bool touched = p.sensor >= 0 && t.sensor[static_cast<std::size_t>(p.sensor)] >= p.threshold;  // false for NaN
    s.reflex_left_s = touched ? p.hold_s + t.dt_s : std::max(0.0, s.reflex_left_s - t.dt_s);
    const bool away = s.reflex_left_s > 0;
    const double share = s.ticks++ == 0 ? 1.0 : away ? 0.0 : t.dt_s / (p.back_s + t.dt_s);  // on its way back it stays
    for (std::uint32_t j = 0; j < t.joints; ++j) {
      s.behind_rad[j] += share * (t.position_rad[j] - s.behind_rad[j]);
      u.torque_nm[j] = p.kp_nm_rad * ((away ? s.behind_rad[j] : t.setpoint_position_rad[j]) - t.position_rad[j]) +
                       p.kd_nm_s_rad * ((away ? 0.0 : t.setpoint_velocity_rad_s[j]) - t.velocity_rad_s[j]);
    }
    probe.reflex_left_s = s.reflex_left_s;
  }
};
LITHE_LAW(Reflex, "reflex");
