// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/cia402/cia402_setpoint_limiter.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace lithe::hal::cia402 {

SetpointLimiter::SetpointLimiter(const DriverParams& params)
    : mode_(params.mode),
      joint_(params.joint),
      counts_per_rev_(params.counts_per_rev),
      rated_torque_nm_(params.rated_torque_nm),
      torque_max_nm_(params.torque_max_nm),
      counts_per_rad_(params.joint.rev_per_rad() * params.counts_per_rev) {
  const double per_rad = std::abs(counts_per_rad_);
  velocity_counts_s_ = per_rad * params.velocity_max_rad_s;
  velocity_change_counts_s_ = per_rad * params.deceleration_rad_s2 * params.period_s;
  period_s_ = params.period_s;
  step_counts_ = velocity_counts_s_ * params.period_s;
  const bool bounded = params.target_min_rad < params.target_max_rad;
  const double one = params.joint.motor_rev(params.target_min_rad) * params.counts_per_rev;
  const double other = params.joint.motor_rev(params.target_max_rad) * params.counts_per_rev;
  least_counts_ = bounded ? std::min(one, other) : -std::numeric_limits<double>::infinity();
  most_counts_ = bounded ? std::max(one, other) : std::numeric_limits<double>::infinity();
  slow_counts_ = velocity_change_counts_s_ * params.period_s;
  share_step_ = params.soft_start_s > params.period_s ? params.period_s / params.soft_start_s : 1;
  torque_step_nm_ = std::min(params.torque_slew_nm_s * params.period_s, params.torque_max_nm * share_step_);
}

RawSetpoint SetpointLimiter::rest(std::uint32_t position_raw) LITHE_RT {
  allowed_nm_ = share_ = last_step_ = at_counts_s_ = 0;
  at_counts_ = last_wanted_ = static_cast<std::int32_t>(position_raw);
  catches_up_ = false;
  return {mode_ == Mode::position ? position_raw : 0, 0};
}

RawSetpoint SetpointLimiter::next(const JointCommand& command, const JointSample& last) LITHE_RT {
  allowed_nm_ = std::min(allowed_nm_ + torque_step_nm_, torque_max_nm_);
  share_ = std::min(share_ + share_step_, 1.0);
  const double limit_nm = std::clamp(command.max_torque_nm, 0.0, allowed_nm_);
  if (mode_ != Mode::position && mode_ != Mode::velocity)
    return {torque_raw(closed_loop_nm(command, last), limit_nm), 0};
  const bool position = mode_ == Mode::position;
  position ? move_position(command) : move_velocity(command);
  return {raw_counts(position ? at_counts_ : at_counts_s_), torque_raw(command.torque_nm, limit_nm)};
}

void SetpointLimiter::move_position(const JointCommand& command) LITHE_RT {
  if (!has_target(command.target_rad)) {
    const double most = velocity_counts_s_ * share_;
    const double wish = std::clamp(command.target_rad_s * counts_per_rad_, -most, most) * period_s_;
    last_step_ = std::clamp(wish, last_step_ - slow_counts_, last_step_ + slow_counts_);
    last_wanted_ = at_counts_;
  } else {
    // Limited to the range of the drive's counter, so that differences are finite.
    constexpr double kMost = 2147483647;
    const double wanted = std::clamp(joint_.motor_rev(command.target_rad) * counts_per_rev_, -kMost, kMost);
    last_step_ = step_to(wanted, step_counts_ * share_);
    last_wanted_ = wanted;
  }
  last_step_ = before_limits(last_step_);
  at_counts_ += last_step_;
}

double SetpointLimiter::before_limits(double step) const LITHE_RT {
  const double way = std::max(step > 0 ? most_counts_ - at_counts_ : at_counts_ - least_counts_, 0.0);
  const double most = std::min(std::sqrt(2 * slow_counts_ * way), way);
  return std::clamp(step, -most, most);
}

// A path that the joint can follow is passed unchanged. To a more distant target it accelerates and decelerates by the
// joint's deceleration.
double SetpointLimiter::step_to(double wanted, double reach) LITHE_RT {
  const double gap = wanted - at_counts_;
  catches_up_ = std::abs(gap) > (catches_up_ ? std::min(slow_counts_, reach) : reach);
  if (!catches_up_) return gap;
  const double own = std::clamp(wanted - last_wanted_, -reach, reach);
  const double wish = own + std::copysign(std::sqrt(2 * slow_counts_ * std::abs(gap)), gap);
  return std::clamp(std::clamp(wish, last_step_ - slow_counts_, last_step_ + slow_counts_), -reach, reach);
}

void SetpointLimiter::move_velocity(const JointCommand& command) LITHE_RT {
  const double most = velocity_counts_s_ * share_;
  const double wanted = std::clamp(command.target_rad_s * counts_per_rad_, -most, most);
  at_counts_s_ += std::clamp(wanted - at_counts_s_, -velocity_change_counts_s_, velocity_change_counts_s_);
}

double SetpointLimiter::closed_loop_nm(const JointCommand& command, const JointSample& last) const LITHE_RT {
  Pd pd = static_cast<const Pd&>(command);  // the rest is not for torque drives
  pd.kp_nm_rad = std::max(command.kp_nm_rad, 0.0);
  pd.kd_nm_s_rad = std::max(command.kd_nm_s_rad, 0.0);
  return pd.felt_nm(last.position_rad, last.velocity_rad_s);
}

// Thousandths of the motor's rated torque. The sum of finite numbers may be infinite.
std::uint32_t SetpointLimiter::torque_raw(double joint_nm, double limit_nm) const LITHE_RT {
  constexpr double kMost = 32767;
  if (!std::isfinite(joint_nm)) return 0;
  const double motor_nm = std::clamp(joint_nm, -limit_nm, limit_nm) / joint_.gear();
  const double thousandths = std::round(std::clamp(1000 * motor_nm / rated_torque_nm_, -kMost, kMost));
  return static_cast<std::uint16_t>(static_cast<std::int16_t>(thousandths));
}

}  // namespace lithe::hal::cia402
