// SPDX-License-Identifier: Apache-2.0
#include "spine/guard/safe_law.hpp"

#include <algorithm>
#include <cmath>

#include "spine/core/pd.hpp"
#include "spine/robot/limits/stopping.hpp"

namespace lithe::guard {

namespace {

double most_rad_s2(const robot::JointConfig& joint) {
  const bool known = joint.inertia_max_kg_m2 > 0 && joint.load_max_nm < joint.torque_max_nm;
  const double possible = known ? robot::brakes_of(joint).deceleration_rad_s2() : 0;
  return std::max(possible, joint.deceleration_rad_s2);
}

}  // namespace

void SafeLaw::configure(const robot::RobotConfig& robot) {
  const std::size_t joints = std::min(robot.joints.size(), kMaxJoints);
  dt_s_ = 1.0 / robot.rate_hz;
  hold_ = robot.guard.safe_end == robot::SafeEnd::hold;
  for (std::size_t j = 0; j < joints; ++j) {
    const robot::JointConfig& from = robot.joints[j];
    joint_[j] = Joint{.position_min_rad = from.position_min_rad,
                      .position_max_rad = from.position_max_rad,
                      .velocity_max_rad_s = from.velocity_max_rad_s,
                      .slowing_rad_s2 = from.deceleration_rad_s2,
                      .most_rad_s2 = most_rad_s2(from),
                      .kp_nm_rad = from.safe_kp_nm_rad,
                      .kd_nm_s_rad = from.safe_kd_nm_s_rad};
  }
}

double SafeLaw::torque_nm(std::size_t index, double position_rad, double velocity_rad_s) LITHE_RT {
  Joint& joint = joint_[index];
  if (!joint.tracking) {
    joint.tracking = true;
    joint.reference_rad = position_rad;
    joint.low_rad = std::min(joint.position_min_rad, position_rad);
    joint.high_rad = std::max(joint.position_max_rad, position_rad);
    joint.reference_rad_s = std::clamp(velocity_rad_s, -joint.velocity_max_rad_s, joint.velocity_max_rad_s);
  }
  const double way_rad = joint.reference_rad_s > 0 ? joint.position_max_rad - joint.reference_rad
                                                   : joint.reference_rad - joint.position_min_rad;
  const double needed_rad_s2 = joint.reference_rad_s * joint.reference_rad_s / (2 * std::max(way_rad, 1e-9));
  const double slowing_rad_s2 = std::clamp(needed_rad_s2, joint.slowing_rad_s2, joint.most_rad_s2);
  const double speed = std::max(0.0, std::abs(joint.reference_rad_s) - slowing_rad_s2 * dt_s_);
  joint.reference_rad_s = std::copysign(speed, joint.reference_rad_s);
  const double next = joint.reference_rad + joint.reference_rad_s * dt_s_;
  joint.reference_rad = std::clamp(next, joint.low_rad, joint.high_rad);
  if (joint.reference_rad != next) joint.reference_rad_s = 0;

  const bool at_rest = joint.reference_rad_s == 0;
  const double stiffness = at_rest && !hold_ ? 0.0 : joint.kp_nm_rad;
  const Pd pd{0.0, joint.reference_rad, joint.reference_rad_s, stiffness, joint.kd_nm_s_rad};
  return pd.pd_nm(position_rad, velocity_rad_s);
}

}  // namespace lithe::guard
