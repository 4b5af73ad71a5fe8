// SPDX-License-Identifier: Apache-2.0
// Fixture for the tests of recover: robots with joints at any start position.
#pragma once

#include <fmt/format.h>

#include <limits>
#include <string>
#include <vector>

#include "spine/loop/test/tick_rig.hpp"

namespace lithe::loop {

struct JointText {
  double min_rad = -3, max_rad = 3, start_rad = 0, mgl_nm = 0.165;
  robot::DeviceKind drive = robot::DeviceKind::moteus;  // or cia402
};

inline constexpr double kRecoverRadS = 1.0, kTorqueMaxNm = 0.6, kRecoverShare = 0.5;

inline robot::RobotConfig robot_of(double rate_hz, const std::vector<JointText>& joints) {
  std::string text = fmt::format(R"(
name = "probe"
rate_hz = {}
[spine]
late_ticks_to_stop = 5
[guard]
recover_velocity_rad_s = {}
recover_torque_share = {}
[brain]
stale_after_s = 0.1
[defaults.device]
kind = "moteus"
bus = "can0"
watchdog_s = 0.1
[defaults.joint]
velocity_max_rad_s = 30.0
torque_max_nm = {}
torque_slew_nm_s = 120.0
deceleration_rad_s2 = 20.0
safe_kd_nm_s_rad = 0.04
[defaults.joint.sim]
inertia_kg_m2 = 2.5e-3
coulomb_nm = 0.01
torque_lag_s = 0.001
[[bus]]
name = "can0"
kind = "loop"
[[bus]]
name = "can1"
kind = "loop"
data_bitrate = 0
)",
                                 rate_hz, kRecoverRadS, kRecoverShare, kTorqueMaxNm);
  for (std::size_t j = 0; j < joints.size(); ++j) {
    text += fmt::format(
        R"(
[[device]]
name = "drive{0}"
id = {1}
{6}
[[joint]]
name = "joint{0}"
device = "drive{0}"
position_min_rad = {2}
position_max_rad = {3}
[joint.sim]
mgl_nm = {4}
initial_position_rad = {5}
)",
        j, j + 1, joints[j].min_rad, joints[j].max_rad, joints[j].mgl_nm, joints[j].start_rad,
        joints[j].drive == robot::DeviceKind::moteus ? "" : "kind = \"cia402\"\nbus = \"can1\"\nrated_torque_nm = 0.6");
  }
  Result<robot::RobotConfig> robot = robot::parse_robot(text, "probe.toml");
  EXPECT_TRUE(robot) << robot.message();
  return *robot;
}

struct PushUp {  // against Push
  struct Params {};
  struct State {};
  static void step(const Tick& t, const Params&, State&, Effort& u) {
    for (std::uint32_t j = 0; j < t.joints; ++j) u.torque_nm[j] = 1000.0;
  }
};
struct PdAll {
  struct Params {};
  struct State {
    double steps = 0;
  };
  static void step(const Tick& t, const Params&, State& s, Effort& u) {
    s.steps += 1;
    for (std::uint32_t j = 0; j < t.joints; ++j)
      u.torque_nm[j] = 4.0 * (t.setpoint_position_rad[j] - t.position_rad[j]) - 0.1 * t.velocity_rad_s[j];
  }
};
struct WrongSign {  // unstable: pushes away from the setpoint, and adds to the speed
  struct Params {};
  struct State {};
  static void step(const Tick& t, const Params&, State&, Effort& u) {
    for (std::uint32_t j = 0; j < t.joints; ++j)
      u.torque_nm[j] = 4.0 * (t.position_rad[j] - t.setpoint_position_rad[j]) + 0.1 * t.velocity_rad_s[j];
  }
};
struct Shake {  // full torque, the other way in each tick
  struct Params {};
  struct State {
    double sign = 1;
  };
  static void step(const Tick& t, const Params&, State& s, Effort& u) {
    s.sign = -s.sign;
    for (std::uint32_t j = 0; j < t.joints; ++j) u.torque_nm[j] = 1000.0 * s.sign;
  }
};
struct NotFiniteLate {
  struct Params {};
  struct State {
    double steps = 0;
  };
  static void step(const Tick& t, const Params&, State& s, Effort& u) {
    s.steps += 1;
    if (s.steps > 20) u.torque_nm[t.joints - 1] = std::numeric_limits<double>::infinity();
  }
};
inline constexpr LitheLaw kWrongSign = describe<WrongSign>("wrong_sign");
inline constexpr LitheLaw kShake = describe<Shake>("shake");
inline constexpr LitheLaw kNotFiniteLate = describe<NotFiniteLate>("not_finite_late");
inline constexpr LitheLaw kPushUp = describe<PushUp>("push_up");
inline constexpr LitheLaw kPdAll = describe<PdAll>("pd_all");

class RecoverBench : public TickBench {
 public:
  using TickBench::TickBench;

  int ticks_in(double seconds) const { return static_cast<int>(seconds * robot_.rate_hz); }
  bool recovering() const { return (record_.flags & wire::telemetry_flag::kRecovering) != 0; }
  bool inside(std::size_t j) const {
    return record_.position_rad[j] >= robot_.joints[j].position_min_rad &&
           record_.position_rad[j] <= robot_.joints[j].position_max_rad;
  }
  bool all_inside() const {
    bool all = true;
    for (std::size_t j = 0; j < robot_.joints.size(); ++j) all = all && inside(j);
    return all;
  }
  // Runs until recover has ended, with or without success. False: not within `seconds`.
  bool finish_recovery(double seconds) {
    for (int left = ticks_in(seconds); left > 0; --left) {
      if (mode() != Mode::recover || !recovering()) return true;
      tick();
    }
    return false;
  }
  wire::Fault fault() const { return static_cast<wire::Fault>(record_.fault); }
};

}  // namespace lithe::loop
