// SPDX-License-Identifier: Apache-2.0
#include "spine/guard/recovery.hpp"

#include <algorithm>
#include <cmath>

namespace lithe::guard {
namespace {

constexpr double kMarginRad = 0.02;     // this far inside its limits a joint is brought
constexpr double kProgressRad = 0.005;  // less than this is no progress
constexpr double kLoadRad = 0.15;       // way over which the integral part finds a load as large as the cap
constexpr double kGoalGainPerS = 2.0;   // speed towards the goal per way that is left
constexpr double kFullShare = 0.9;      // of the recover torque: more counts as all of it
constexpr double kDelayTicks = 2.5;     // from a sample to the torque made from it: one tick, hold, bus and drive
constexpr double kDelayShare = 0.3;     // of the damping that the integral part may cost at that delay

// How far beyond [min, max]; negative inside.
double beyond(double position_rad, double min_rad, double max_rad) LITHE_RT {
  return std::max(position_rad - max_rad, min_rad - position_rad);
}

}  // namespace

void Recovery::configure(const robot::RobotConfig& robot) {
  joints_ = std::min(robot.joints.size(), kMaxJoints);
  dt_s_ = 1.0 / robot.rate_hz;
  velocity_rad_s_ = robot.guard.recover_velocity_rad_s;
  share_ = robot.guard.recover_torque_share;
  soft_stop_per_rad_ = 1.0 / std::max(robot.guard.soft_stop_rad, 1.0e-9);
  for (std::size_t j = 0; j < joints_; ++j) {
    const robot::JointConfig& from = robot.joints[j];
    const double divider = from.device < robot.devices.size() ? robot.devices[from.device].rate_divider : 1.0;
    const double delay_s = kDelayTicks * divider * dt_s_;
    const double margin_rad = std::min(kMarginRad, 0.25 * (from.position_max_rad - from.position_min_rad));
    Joint joint;
    joint.min_rad = from.position_min_rad;
    joint.max_rad = from.position_max_rad;
    joint.low_rad = from.position_min_rad + margin_rad;
    joint.high_rad = from.position_max_rad - margin_rad;
    joint.cap_nm = share_ * from.torque_max_nm;
    joint.kd_nm_s_rad = from.safe_kd_nm_s_rad;
    joint.ki_nm_rad = std::min(joint.cap_nm / kLoadRad, kDelayShare * joint.kd_nm_s_rad / delay_s);
    const double ramp_s = joint.cap_nm / std::max(joint.ki_nm_rad * velocity_rad_s_, 1.0e-9);
    joint.stall_ticks = std::llround((std::min(ramp_s, 600.0) + kStallS) * robot.rate_hz);
    joint_[j] = joint;
  }
}

void Recovery::restart() LITHE_RT {
  for (std::size_t j = 0; j < joints_; ++j) joint_[j].state = State::fresh;
}

void Recovery::start(Joint& joint, double position_rad, double now_nm) LITHE_RT {
  joint.goal_rad = std::clamp(position_rad, joint.low_rad, joint.high_rad);
  joint.from = position_rad > joint.high_rad ? 1 : position_rad < joint.low_rad ? -1 : 0;
  joint.load_nm = std::clamp(now_nm, -joint.cap_nm, joint.cap_nm);
  joint.least_beyond_rad = std::max(0.0, beyond(position_rad, joint.low_rad, joint.high_rad));
  joint.ticks_at_least = 0;
  const double longest_s = std::min(3 * joint.least_beyond_rad / velocity_rad_s_ + kPatienceS, 1.0e6);
  joint.ticks_left = joint.stall_ticks + static_cast<std::int64_t>(longest_s / dt_s_);
  joint.state = State::moving;
}

// Checks progress towards the limits. A joint that was inside them and leaves them again restarts its recovery.
void Recovery::watch(Joint& joint, double position_rad) LITHE_RT {
  if (joint.state == State::stuck) return;
  if (joint.state == State::inside) {
    if (beyond(position_rad, joint.min_rad, joint.max_rad) <= 0) return;
    start(joint, position_rad, joint.load_nm);
  }
  const double left_rad = beyond(position_rad, joint.low_rad, joint.high_rad);
  if (left_rad <= 0.5 * (joint.low_rad - joint.min_rad)) {
    joint.state = State::inside;
    return;
  }
  ++joint.ticks_at_least;
  --joint.ticks_left;
  if (left_rad < joint.least_beyond_rad - kProgressRad) {
    joint.least_beyond_rad = left_rad;
    joint.ticks_at_least = 0;
  }
  if (joint.ticks_at_least > joint.stall_ticks || joint.ticks_left < 0) joint.state = State::stuck;
}

double Recovery::torque_nm(std::size_t index, double position_rad, double velocity_rad_s, double now_nm) LITHE_RT {
  Joint& joint = joint_[index];
  if (joint.state == State::fresh) start(joint, position_rad, now_nm);
  watch(joint, position_rad);
  const double towards_rad_s =
      std::clamp(kGoalGainPerS * (joint.goal_rad - position_rad), -velocity_rad_s_, velocity_rad_s_);
  const double error_rad_s = towards_rad_s - velocity_rad_s;
  joint.load_nm = std::clamp(joint.load_nm + joint.ki_nm_rad * error_rad_s * dt_s_, -joint.cap_nm, joint.cap_nm);
  const double wanted_nm = joint.load_nm + joint.kd_nm_s_rad * error_rad_s;
  return permitted(joint, std::clamp(wanted_nm, -joint.cap_nm, joint.cap_nm), position_rad, velocity_rad_s);
}

double Recovery::target_rad_s(std::size_t index, double position_rad, double torque_nm) LITHE_RT {
  Joint& joint = joint_[index];
  if (joint.state == State::fresh) start(joint, position_rad, torque_nm);
  watch(joint, position_rad);
  const double towards_rad_s =
      std::clamp(kGoalGainPerS * (joint.goal_rad - position_rad), -velocity_rad_s_, velocity_rad_s_);
  joint.load_nm = std::clamp(torque_nm, -joint.cap_nm, joint.cap_nm);
  const double pushes_nm = towards_rad_s > 0 ? joint.load_nm : -joint.load_nm;
  return towards_rad_s * std::clamp((joint.cap_nm - pushes_nm) / ((1 - kFullShare) * joint.cap_nm), 0.0, 1.0);
}

double Recovery::permitted(const Joint& joint, double wanted_nm, double position_rad, double velocity_rad_s) const
    LITHE_RT {
  const bool above = position_rad > joint.max_rad;
  if (!above && position_rad >= joint.min_rad) {
    const double way_left_rad = wanted_nm > 0 ? joint.max_rad - position_rad : position_rad - joint.min_rad;
    return wanted_nm * std::clamp(way_left_rad * soft_stop_per_rad_, 0.0, 1.0);
  }
  const double inward = above ? -1.0 : 1.0;
  const double inward_rad_s = inward * velocity_rad_s;
  const double inward_nm = inward * wanted_nm;
  if (inward_nm > 0) return wanted_nm * std::clamp(2 - inward_rad_s / velocity_rad_s_, 0.0, 1.0);
  const double brake_nm = joint.cap_nm * std::clamp(inward_rad_s / velocity_rad_s_, 0.0, 1.0);
  return inward * std::max(inward_nm, -brake_nm);
}

bool Recovery::inside(std::size_t index, double position_rad) const LITHE_RT {
  const Joint& joint = joint_[index];
  return beyond(position_rad, joint.min_rad, joint.max_rad) <= kAtLimitRad;  // false for NaN
}

std::string_view Recovery::why_stuck(std::size_t index) const LITHE_RT {
  const Joint& joint = joint_[index];
  if (!stuck(index)) return "";
  if (joint.ticks_left < 0) return "no time left";
  return std::abs(joint.load_nm) >= kFullShare * joint.cap_nm ? "the recover torque does not move it (load, or a stop)"
                                                              : "it does not move";
}

}  // namespace lithe::guard
