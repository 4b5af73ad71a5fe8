// SPDX-License-Identifier: Apache-2.0
// The servo's planner: motion of its setpoint.
#include <algorithm>
#include <cmath>

#include "spine/hal/moteus/sim/servo.hpp"

namespace lithe::hal::sim {

namespace {

constexpr double kStepS = 1e-9 * static_cast<double>(Plant::kStepNs);

}  // namespace

void Servo::move_set_point() LITHE_RT {
  if (!trajectory_complete_) plan_velocity();
  control_position_rev_ += control_velocity_rev_s_ * kStepS;
  const double stop = command_.stop_position_rev;
  const double velocity = control_velocity_rev_s_;
  if (velocity != 0 && velocity * (control_position_rev_ - stop) > 0) {  // false while there is no stop position
    control_position_rev_ = stop;
    control_velocity_rev_s_ = 0;
  }
  if (command_.ignore_bounds != 0) return;
  if (control_position_rev_ < params_.position_min_rev) {
    control_position_rev_ = params_.position_min_rev;
    control_velocity_rev_s_ = 0;
    fault_ = moteus::fault::kLimitBounds;
  } else if (control_position_rev_ > params_.position_max_rev) {
    control_position_rev_ = params_.position_max_rev;
    control_velocity_rev_s_ = 0;
    fault_ = moteus::fault::kLimitBounds;
  }
}

// One step of a trapezoid towards a goal that moves with the commanded velocity. Without a position to reach, only the
// velocity is brought there.
void Servo::plan_velocity() LITHE_RT {
  goal_rev_ += command_.velocity_rev_s * kStepS;
  const bool free = std::isnan(command_.position_rev);
  const double gap = free ? 0 : goal_rev_ - control_position_rev_;
  double wanted = command_.velocity_rev_s;
  const double most = acceleration_limit_ * kStepS;  // NaN: any change at once
  if (gap != 0) {
    // The largest velocity from which it can still brake, one step ahead.
    const double reach = std::isnan(acceleration_limit_)
                             ? std::abs(gap) / kStepS
                             : std::sqrt(acceleration_limit_ * acceleration_limit_ * kStepS * kStepS / 4 +
                                         2 * acceleration_limit_ * std::abs(gap)) -
                                   most / 2;
    wanted += std::copysign(std::min(reach, std::abs(gap) / kStepS), gap);
  }
  if (!std::isnan(velocity_limit_)) wanted = std::clamp(wanted, -velocity_limit_, velocity_limit_);
  const double change = wanted - control_velocity_rev_s_;
  control_velocity_rev_s_ += std::isnan(most) ? change : std::clamp(change, -most, most);
  const double left = std::abs(gap - (control_velocity_rev_s_ - command_.velocity_rev_s) * kStepS);
  if (left > 1e-9 || control_velocity_rev_s_ != wanted) return;
  if (std::abs(wanted - command_.velocity_rev_s) * kStepS > 1e-7) return;
  if (!free) control_position_rev_ = goal_rev_ - command_.velocity_rev_s * kStepS;
  control_velocity_rev_s_ = command_.velocity_rev_s;
  trajectory_complete_ = true;
}

}  // namespace lithe::hal::sim
