// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/moteus/sim/servo.hpp"

#include <algorithm>
#include <cmath>

namespace lithe::hal::sim {

using moteus::Mode;

namespace {

constexpr std::int64_t kEnablingNs = 1'000'000;
constexpr std::int64_t kCalibratingNs = 4'000'000;

// A limit register: NaN = as configured, negative = no limit.
double effective_limit(double commanded, double configured) LITHE_RT {
  const double limit = std::isnan(commanded) ? configured : commanded;
  return limit >= 0 ? limit : ServoParams::kNone;
}

bool has_watchdog(Mode mode) LITHE_RT { return mode == Mode::position || mode == Mode::stay_within; }

}  // namespace

Servo::Servo(const ServoParams& params, const JointTransform& joint, const PlantParams& plant,
             const DriveErrors& errors)
    : CoupledDrive(encoder_of(params), joint, plant, errors), params_(params), home_(params.home_at_power_on) {}

void Servo::on_skip() LITHE_RT {
  handle_due();
  check_watchdog();
}

void Servo::step() LITHE_RT {
  handle_due();
  check_watchdog();
  // A drive that is off does not check.
  if (ailment_ != 0 && mode_ != Mode::stopped && mode_ != Mode::fault) fail(ailment_);
  if (mode_ == Mode::enabling && time_ns_ >= phase_end_ns_) {
    mode_ = Mode::calibrating;
    phase_end_ns_ = time_ns_ + kCalibratingNs;
  } else if (mode_ == Mode::calibrating && time_ns_ >= phase_end_ns_) {
    mode_ = Mode::calibration_complete;
  } else if (mode_ == Mode::calibration_complete) {
    enter(target_);
  }
  wanted_nm_ = motor_torque();
  // An invalid register value must not give the plant a NaN position.
  if (!std::isfinite(wanted_nm_)) wanted_nm_ = 0;
  wanted_nm_ = std::clamp(wanted_nm_, -params_.motor_torque_max_nm, params_.motor_torque_max_nm);
  move(wanted_nm_);
}

void Servo::check_watchdog() LITHE_RT {
  if (has_watchdog(mode_) && time_ns_ >= watchdog_end_ns_) mode_ = Mode::timeout;
}

void Servo::judge_health() LITHE_RT {
  const double to_fault_c = params_.fault_temperature_c - params_.temperature_c;
  ailment_ = to_fault_c < 0 ? moteus::fault::kOverTemperature : 0;
  if (encoder_lost_) ailment_ = moteus::fault::kEncoder;
  if (driver_failed_) ailment_ = moteus::fault::kDriver;
  const bool hot = to_fault_c >= 0 && to_fault_c < params_.temperature_margin_c;
  hot_torque_max_nm_ = hot ? params_.motor_torque_max_nm * to_fault_c / params_.temperature_margin_c : kNoEnd;
}

void Servo::restart(const ServoParams& params) LITHE_RT {
  configure(params);
  mode_ = target_ = Mode::stopped;
  fault_ = 0;
  command_ = ServoCommand{};
  underway_count_ = 0;
  offset_rev_ = 0;
  home_ = params_.home_at_power_on;
  terms_ = Terms{};
  trajectory_complete_ = false;
  measure();
  tracked_rev_ = control_position_rev_ = encoder_rev_;
  velocity_rev_s_ = control_velocity_rev_s_ = 0;
}

void Servo::set_output(double position_rev, bool exact) LITHE_RT {
  const double by = exact ? position_rev - encoder_rev_ : std::round(position_rev - encoder_rev_);
  constexpr double kFarthest = 32768;  // what the drive can count
  if (!(std::abs(offset_rev_ + by) <= kFarthest)) return;
  home_ = 2;
  for (double* moved : {&offset_rev_, &encoder_rev_, &tracked_rev_, &control_position_rev_, &goal_rev_}) *moved += by;
}

void Servo::recapture() LITHE_RT {
  control_position_rev_ = goal_rev_ = encoder_rev_;
  control_velocity_rev_s_ = velocity_rev_s_;
}

void Servo::apply(Mode mode, const ServoCommand& command) LITHE_RT {
  const bool goes_on = mode == mode_ && has_watchdog(mode);
  if (!goes_on) underway_count_ = 0;
  if (!goes_on || errors_.delay_ns() == 0 || !started_) return handle(mode, command);
  if (underway_count_ == kOnTheWay) {
    underway_[first_underway_].due_ns = time_ns_;
    handle_due();
  }
  underway_[(first_underway_ + underway_count_++) % kOnTheWay] = {time_ns_ + errors_.delay_ns(), mode, command};
}

void Servo::handle_due() LITHE_RT {
  while (underway_count_ > 0 && underway_[first_underway_].due_ns <= time_ns_) {
    const Underway& oldest = underway_[first_underway_];
    first_underway_ = (first_underway_ + 1) % kOnTheWay;
    --underway_count_;
    handle(oldest.mode, oldest.command);
  }
}

void Servo::handle(Mode mode, const ServoCommand& command) LITHE_RT {
  if (mode == Mode::stopped) {
    mode_ = Mode::stopped;
    fault_ = 0;
    command_ = command;
    return;
  }
  command_ = command;  // also in `timeout`: damping uses the last command's gain scale
  if (mode_ == Mode::fault || mode_ == Mode::timeout) return;
  if (mode_ > Mode::calibration_complete) return enter(mode);
  target_ = mode;
  if (mode_ != Mode::stopped) return;
  mode_ = Mode::enabling;
  phase_end_ns_ = time_ns_ + kEnablingNs;
}

void Servo::enter(Mode mode) LITHE_RT {
  const bool starts = has_watchdog(mode) && !has_watchdog(mode_);
  if (starts && command_.ignore_bounds == 0 && outside_bounds()) return fail(moteus::fault::kOutsideLimit);
  if (starts) {
    terms_ = Terms{};
    control_position_rev_ = encoder_rev_;
    control_velocity_rev_s_ = velocity_rev_s_;
  }
  mode_ = mode;
  fault_ = 0;
  start_command();
}

void Servo::start_command() LITHE_RT {
  if (!has_watchdog(mode_)) return;
  const double watchdog_s = command_.watchdog_s == 0 ? params_.default_watchdog_s : command_.watchdog_s;
  constexpr double kLongestS = 1e6;
  watchdog_end_ns_ = std::isnan(watchdog_s)
                         ? kNever
                         : time_ns_ + static_cast<std::int64_t>(1e9 * std::clamp(watchdog_s, 0.0, kLongestS));
  velocity_limit_ = effective_limit(command_.velocity_limit_rev_s, params_.default_velocity_limit_rev_s);
  acceleration_limit_ = effective_limit(command_.acceleration_limit_rev_s2, params_.default_acceleration_limit_rev_s2);
  const bool planned = !std::isnan(velocity_limit_) || !std::isnan(acceleration_limit_);
  if (planned && !std::isnan(command_.stop_position_rev)) return fail(moteus::fault::kStopPosition);
  if (std::isnan(command_.velocity_rev_s)) command_.velocity_rev_s = 0;
  goal_rev_ = std::isnan(command_.position_rev) ? encoder_rev_ : command_.position_rev;
  trajectory_complete_ = !planned;
  if (planned) return;
  control_position_rev_ = goal_rev_;
  control_velocity_rev_s_ = command_.velocity_rev_s;
}

void Servo::fail(std::uint32_t fault) LITHE_RT {
  mode_ = Mode::fault;
  fault_ = fault;
}

double Servo::torque_nm() const LITHE_RT {
  return driving(mode_) ? errors_.told_nm(plant_.torque_nm()) / joint_.gear() : 0;
}

bool Servo::driving(Mode mode) const LITHE_RT {
  return mode >= Mode::pwm && mode != Mode::brake && mode != Mode::measure_inductance;
}

bool Servo::outside_bounds() const LITHE_RT {
  return encoder_rev_ < params_.position_min_rev || encoder_rev_ > params_.position_max_rev;
}

double Servo::motor_torque() LITHE_RT {
  if (mode_ == Mode::current) return params_.torque_constant_nm_a * command_.q_current_a;
  if (mode_ == Mode::position) return position_torque();
  if (mode_ == Mode::stay_within) return within_torque();
  if (mode_ == Mode::timeout) return timeout_torque();
  if (mode_ == Mode::zero_velocity) return damping_torque();
  return mode_ == Mode::brake ? brake_torque() : 0;
}

// Uses the gain scale of the last command of any mode: without a gain in the command there is no damping.
double Servo::damping_torque() LITHE_RT {
  const double most = std::abs(params_.timeout_max_torque_nm);
  return std::clamp(-params_.kd_nm_s_rev * command_.kd_scale * velocity_rev_s_, -most, most);
}

double Servo::timeout_torque() LITHE_RT {
  const auto mode = static_cast<Mode>(static_cast<int>(params_.timeout_mode));
  if (mode == Mode::zero_velocity) return damping_torque();
  if (mode == Mode::brake) return brake_torque();
  if (mode != Mode::position) return 0;
  // With all of its own gains.
  return params_.kp_nm_rev * (control_position_rev_ - encoder_rev_) - params_.kd_nm_s_rev * velocity_rev_s_;
}

// Shorted windings: the induced voltage drives a braking current.
double Servo::brake_torque() LITHE_RT {
  const double drag_nm_s_rad = params_.torque_constant_nm_a * params_.torque_constant_nm_a / params_.resistance_ohm;
  return -drag_nm_s_rad * 2 * std::numbers::pi * joint_.rev_per_rad() * plant_.velocity_rad_s();
}

// Torque limit reduced by temperature; reported in the fault code.
double Servo::torque_limit() LITHE_RT {
  const double asked =
      std::isnan(command_.max_torque_nm) ? params_.motor_torque_max_nm : std::abs(command_.max_torque_nm);
  if (hot_torque_max_nm_ == kNoEnd) return asked;
  fault_ = moteus::fault::kLimitTemperature;
  return std::min(asked, hot_torque_max_nm_);
}

double Servo::pd(double position_rev, double velocity_rev_s) LITHE_RT {
  terms_.error_rev = position_rev - encoder_rev_;
  terms_.error_rev_s = velocity_rev_s - velocity_rev_s_;
  terms_.p_nm = params_.kp_nm_rev * command_.kp_scale * terms_.error_rev;
  terms_.d_nm = params_.kd_nm_s_rev * command_.kd_scale * terms_.error_rev_s;
  const double most_nm = std::abs(params_.integral_limit_nm * command_.integral_scale);
  terms_.i_nm =
      most_nm > 0 ? std::clamp(terms_.i_nm + Plant::kStepS * params_.ki_nm_rev_s * terms_.error_rev, -most_nm, most_nm)
                  : 0;
  const double wanted = terms_.p_nm + terms_.i_nm + terms_.d_nm + command_.torque_nm;
  const double limit = torque_limit();
  if (!(std::abs(wanted) > limit)) return wanted;
  if (fault_ != moteus::fault::kLimitTemperature) fault_ = moteus::fault::kLimitTorque;
  return std::copysign(limit, wanted);
}

double Servo::position_torque() LITHE_RT {
  if (fault_ != moteus::fault::kLimitBounds) fault_ = 0;  // a clipped setpoint stays clipped until the next command
  move_set_point();
  return pd(control_position_rev_, control_velocity_rev_s_);
}

double Servo::within_torque() LITHE_RT {
  fault_ = 0;
  const double lower = command_.lower_bound_rev;
  const double upper = command_.upper_bound_rev;
  if (encoder_rev_ < lower) return pd(lower, 0);
  if (encoder_rev_ > upper) return pd(upper, 0);
  const double limit = torque_limit();
  return std::clamp(command_.torque_nm, -limit, limit);
}

// The planner: motion of the setpoint.
void Servo::move_set_point() LITHE_RT {
  if (!trajectory_complete_) plan_velocity();
  control_position_rev_ += control_velocity_rev_s_ * Plant::kStepS;
  const double stop = command_.stop_position_rev;
  const double velocity = control_velocity_rev_s_;
  if (velocity != 0 && velocity * (control_position_rev_ - stop) > 0) {  // false while there is no stop position
    control_position_rev_ = stop;
    control_velocity_rev_s_ = 0;
  }
  if (command_.ignore_bounds != 0) return;
  const bool below = control_position_rev_ < params_.position_min_rev;
  if (!below && !(control_position_rev_ > params_.position_max_rev)) return;
  control_position_rev_ = below ? params_.position_min_rev : params_.position_max_rev;
  control_velocity_rev_s_ = 0;
  fault_ = moteus::fault::kLimitBounds;
}

// One step of a trapezoid towards a goal that moves with the commanded velocity. Without a position to reach, only the
// velocity is brought there.
void Servo::plan_velocity() LITHE_RT {
  goal_rev_ += command_.velocity_rev_s * Plant::kStepS;
  const bool free = std::isnan(command_.position_rev);
  const double gap = free ? 0 : goal_rev_ - control_position_rev_;
  double wanted = command_.velocity_rev_s;
  const double most = acceleration_limit_ * Plant::kStepS;  // NaN: any change at once
  if (gap != 0) {
    // The largest velocity from which it can still brake, one step ahead.
    const double reach = std::isnan(acceleration_limit_)
                             ? std::abs(gap) / Plant::kStepS
                             : std::sqrt(acceleration_limit_ * acceleration_limit_ * Plant::kStepS * Plant::kStepS / 4 +
                                         2 * acceleration_limit_ * std::abs(gap)) -
                                   most / 2;
    wanted += std::copysign(std::min(reach, std::abs(gap) / Plant::kStepS), gap);
  }
  if (!std::isnan(velocity_limit_)) wanted = std::clamp(wanted, -velocity_limit_, velocity_limit_);
  const double change = wanted - control_velocity_rev_s_;
  control_velocity_rev_s_ += std::isnan(most) ? change : std::clamp(change, -most, most);
  const double left = std::abs(gap - (control_velocity_rev_s_ - command_.velocity_rev_s) * Plant::kStepS);
  if (left > 1e-9 || control_velocity_rev_s_ != wanted) return;
  if (std::abs(wanted - command_.velocity_rev_s) * Plant::kStepS > 1e-7) return;
  if (!free) control_position_rev_ = goal_rev_ - command_.velocity_rev_s * Plant::kStepS;
  control_velocity_rev_s_ = command_.velocity_rev_s;
  trajectory_complete_ = true;
}

}  // namespace lithe::hal::sim
