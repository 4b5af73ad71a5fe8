// SPDX-License-Identifier: Apache-2.0
// Fixture of the guard's tests: a robot and the guard's inputs.
#pragma once

#include <algorithm>
#include <limits>

#include "spine/guard/guard.hpp"

namespace lithe::guard {

inline constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
inline constexpr double kSlewPerTick = 0.1;  // 100 Nm/s at 1 kHz
inline constexpr double kTickS = 1e-3;

inline robot::RobotConfig robot_with(std::size_t joints) {
  robot::RobotConfig robot;
  robot.rate_hz = 1000;
  robot.guard.soft_start_s = 0;
  robot.joints.resize(joints);
  for (robot::JointConfig& joint : robot.joints) {
    joint.position_min_rad = -2;
    joint.position_max_rad = 3;
    joint.velocity_max_rad_s = 10;
    joint.torque_max_nm = 1;
    joint.torque_slew_nm_s = 100;
    joint.kp_max_nm_rad = 50;
    joint.kd_max_nm_s_rad = 2;
    joint.safe_kp_nm_rad = 5;
    joint.safe_kd_nm_s_rad = 0.5;
  }
  return robot;
}

// The guard's output, and what became of each joint.
struct Output : JointCommands {
  std::array<Rung, kMaxJoints> rung{};
};

// Inputs of a guard with normal values, which a test changes.
struct Bench {
  explicit Bench(const robot::RobotConfig& robot = robot_with(1)) {
    guard.configure(robot);
    effort.position_rad.fill(kNoTarget);
    status.fill(wire::joint_status::kFresh);
  }

  // One tick: the previous output was sent, unless the bus was late.
  Verdict check(bool bus_in_time = true) {
    if (bus_in_time) guard.dispatched();
    const Verdict verdict = guard.check({mode, stale_ticks, brain_age_ns, position, velocity, status, effort}, out);
    for (std::size_t j = 0; j < kMaxJoints; ++j) out.rung[j] = guard.rung(j);
    return verdict;
  }
  // The torque joint j will feel by an output: feed-forward and the drive's own PD, where the joint is when the next
  // command reaches it.
  double felt_nm(const Output& by, std::size_t j) const {
    return std::clamp(pd_of(by, j).felt_nm(position[j] + velocity[j] * kTickS, velocity[j]), -1.0, 1.0);
  }
  double felt_nm(std::size_t j = 0) const { return felt_nm(out, j); }
  Verdict settle(int ticks = 50) {
    Verdict verdict;
    for (int i = 0; i < ticks; ++i) verdict = check();
    return verdict;
  }
  Rung rung_after(int ticks, std::size_t j = 0) {
    settle(ticks);
    return out.rung[j];
  }

  Guard guard;
  Output out;
  wire::Mode mode = wire::Mode::active;
  std::uint32_t stale_ticks = 0;
  std::int64_t brain_age_ns = 1'000'000;
  JointArray position{}, velocity{};
  Effort effort;
  // Short names of what the law wants.
  JointArray &torque = effort.torque_nm, &position_target = effort.position_rad,
             &velocity_target = effort.velocity_rad_s, &kp = effort.kp_nm_rad, &kd = effort.kd_nm_s_rad;
  std::array<std::uint32_t, kMaxJoints> status{};
};

}  // namespace lithe::guard
