// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/cia402/sim/cia402_servo.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "spine/core/time.hpp"
#include "spine/hal/canopen/canopen.hpp"

namespace lithe::hal::sim {

using cia402::Mode;
using cia402::State;
namespace status_bit = cia402::status_bit;

namespace {

// A ramp has ended after this time below this velocity. One encoder count already appears as a velocity.
constexpr double kStandsRevPerS = 0.01;
constexpr double kStandsCountsPerS = 1000;
constexpr std::int64_t kStandsNs = 20'000'000;
constexpr double kThousandths = 1000;

std::int32_t whole(double value) LITHE_RT {
  constexpr double kMost = 2147483647.0;
  if (std::isnan(value)) return 0;
  return static_cast<std::int32_t>(std::clamp(std::round(value), -kMost, kMost));
}

}  // namespace

Cia402Servo::Cia402Servo(const Cia402ServoParams& params, const JointTransform& joint, const PlantParams& plant,
                         const DriveErrors& errors)
    : CoupledDrive({params.counts_per_rev, params.velocity_filter_hz}, joint, plant, errors),
      params_(params),
      target_nm_(static_cast<std::size_t>(errors.delay_ns / Plant::kStepNs)) {
  constexpr double kTurn = 2 * std::numbers::pi;
  const double omega = kTurn * params.loop_hz;
  const double motor_inertia = plant.inertia_kg_m2 / (joint.ratio * joint.ratio);
  stiffness_nm_rev_ = motor_inertia * omega * omega * kTurn;
  damping_nm_s_rev_ = 2 * motor_inertia * omega * kTurn;
}

void Cia402Servo::restart() LITHE_RT {
  state_ = State::switch_on_disabled;
  last_word_ = 0;
  error_code_ = 0;
  limited_ = following_error_ = false;
  inputs_ = {};
}

void Cia402Servo::step() LITHE_RT {
  const double wanted_nm = powered() ? motor_torque() : 0;
  move(std::isfinite(wanted_nm) ? wanted_nm : 0);
}

bool Cia402Servo::powered() const LITHE_RT {
  return state_ == State::operation_enabled || state_ == State::quick_stop_active ||
         state_ == State::fault_reaction_active;
}

void Cia402Servo::enter(State state) LITHE_RT {
  if (state == state_) return;
  if (state_ == State::fault) following_error_ = false;
  state_ = state;
  limited_ = false;
  behind_since_ns_ = kNever;
  enabling_from_ns_ = kNever;
  if (state != State::operation_enabled) return;
  target_nm_.clear();
  hold();
  sync();
}

void Cia402Servo::hold() LITHE_RT {
  demand_rev_ = goal_rev_ = encoder_rev_;
  demand_rev_s_ = 0;
  goal_ns_ = time_ns_;
}

void Cia402Servo::set_inputs(const Cia402Inputs& inputs) LITHE_RT {
  const bool other_mode = inputs.mode != inputs_.mode;
  inputs_ = inputs;
  if (other_mode) hold();
}

void Cia402Servo::set_error(std::uint16_t code) LITHE_RT {
  if (code == error_code_) return;
  error_code_ = code;
  ++error_changes_;
}

void Cia402Servo::begin_ramp() LITHE_RT {
  demand_rev_ = encoder_rev_;
  demand_rev_s_ = velocity_rev_s_;
  stands_from_ns_ = time_ns_;
}

void Cia402Servo::sync() LITHE_RT {
  if (state_ != State::operation_enabled || inputs_.mode != Mode::position) return;
  std::int64_t target = std::int64_t{inputs_.target_position} + inputs_.position_offset;
  if (inputs_.position_min < inputs_.position_max)
    target = std::clamp(target, std::int64_t{inputs_.position_min}, std::int64_t{inputs_.position_max});
  goal_rev_ = static_cast<double>(target) / params_.counts_per_rev;
  goal_ns_ = time_ns_ + inputs_.period_ns;
}

double Cia402Servo::motor_torque() LITHE_RT {
  if (state_ != State::operation_enabled) {
    ramp();
    return powered() ? limited(towards_demand()) : 0;
  }
  if (ignores_target_) return 0;
  const double offset_nm = inputs_.torque_offset * params_.rated_torque_nm / kThousandths;
  switch (inputs_.mode) {
    case Mode::torque:
      return limited(target_nm_.next(inputs_.target_torque * params_.rated_torque_nm / kThousandths + offset_nm));
    case Mode::velocity:
      demand_rev_s_ = (static_cast<double>(inputs_.target_velocity) + inputs_.velocity_offset) / params_.counts_per_rev;
      demand_rev_ += demand_rev_s_ * Plant::kStepS;
      return limited(towards_demand() + offset_nm);
    case Mode::position: {
      const std::int64_t left_ns = std::max(goal_ns_ - time_ns_, Plant::kStepNs);
      const double moved_rev =
          (goal_rev_ - demand_rev_) * static_cast<double>(Plant::kStepNs) / static_cast<double>(left_ns);
      demand_rev_ += moved_rev;
      demand_rev_s_ = moved_rev / Plant::kStepS + inputs_.velocity_offset / params_.counts_per_rev;
      const double torque_nm = limited(towards_demand() + offset_nm);
      watch_following();
      return torque_nm;
    }
    case Mode::none:
      break;
  }
  return 0;
}

double Cia402Servo::towards_demand() LITHE_RT {
  const double wanted_nm =
      stiffness_nm_rev_ * (demand_rev_ - encoder_rev_) + damping_nm_s_rev_ * (demand_rev_s_ - velocity_rev_s_);
  if (inputs_.mode == Mode::position && state_ == State::operation_enabled) return wanted_nm;
  // Anti-windup: a demand that the torque limit cannot follow does not run ahead.
  const double reach_rev = params_.motor_torque_max_nm / stiffness_nm_rev_;
  demand_rev_ = std::clamp(demand_rev_, encoder_rev_ - reach_rev, encoder_rev_ + reach_rev);
  return wanted_nm;
}

double Cia402Servo::limited(double torque_nm) LITHE_RT {
  const double unit_nm = params_.rated_torque_nm / kThousandths;
  const double most_nm = std::min(inputs_.positive_torque * unit_nm, params_.motor_torque_max_nm);
  const double least_nm = -std::min(inputs_.negative_torque * unit_nm, params_.motor_torque_max_nm);
  limited_ = torque_nm > most_nm || torque_nm < least_nm;
  return std::clamp(torque_nm, least_nm, most_nm);
}

// Quick stop and fault reaction: the demand ramps down; when it and the joint have stopped, power is switched off.
void Cia402Servo::ramp() LITHE_RT {
  constexpr std::int32_t kStaysFrom = 5;  // options of 605Ah that end in `quick stop active`
  const double change = inputs_.deceleration / params_.counts_per_rev * Plant::kStepS;
  demand_rev_s_ = std::copysign(std::max(std::abs(demand_rev_s_) - change, 0.0), demand_rev_s_);
  demand_rev_ += demand_rev_s_ * Plant::kStepS;
  const double stands_rev_s = std::max(kStandsRevPerS, kStandsCountsPerS / params_.counts_per_rev);
  if (demand_rev_s_ != 0 || std::abs(velocity_rev_s_) > stands_rev_s) stands_from_ns_ = time_ns_;
  if (time_ns_ - stands_from_ns_ < kStandsNs) return;
  if (state_ == State::fault_reaction_active) return enter(State::fault);
  if (inputs_.quick_stop_option < kStaysFrom) enter(State::switch_on_disabled);
}

void Cia402Servo::watch_following() LITHE_RT {
  constexpr std::uint32_t kNoWindow = 0xffff'ffff;
  const double error_counts = std::abs(demand_rev_ - encoder_rev_) * params_.counts_per_rev;
  const bool behind = inputs_.following_window != kNoWindow && error_counts > inputs_.following_window;
  if (!behind) {
    behind_since_ns_ = kNever;
    return;
  }
  if (behind_since_ns_ == kNever) behind_since_ns_ = time_ns_;
  if (time_ns_ - behind_since_ns_ < inputs_.following_timeout_ms * kNsPerMs) return;
  fail(canopen::emergency::kFollowingError, false);
  following_error_ = true;
}

std::uint16_t Cia402Servo::statusword() const LITHE_RT {
  std::uint16_t word = cia402::encode_state(state_) | status_bit::kRemote;
  if (powered() || state_ == State::switched_on) word |= status_bit::kVoltage;
  if (limited_) word |= status_bit::kLimited;
  const bool follows = state_ == State::operation_enabled && cia402::is_cyclic(inputs_.mode) && !ignores_target_;
  if (follows) word |= status_bit::kFollows;
  if (following_error_) word |= status_bit::kFollowingError;
  return word;
}

std::int32_t Cia402Servo::position() const LITHE_RT { return whole(encoder_rev_ * params_.counts_per_rev); }

std::int32_t Cia402Servo::velocity() const LITHE_RT {
  return whole(velocity_rev_s_ * params_.counts_per_rev * params_.velocity_unit);
}

std::int32_t Cia402Servo::torque() const LITHE_RT {
  constexpr double kMost = 32767;
  if (!powered()) return 0;
  const double thousandths =
      kThousandths * errors_.told_nm(plant_.torque_nm()) / joint_.gear() / params_.rated_torque_nm;
  return whole(std::clamp(thousandths, -kMost, kMost));
}

std::int32_t Cia402Servo::following_error() const LITHE_RT {
  return whole((demand_rev_ - encoder_rev_) * params_.counts_per_rev);
}

// State machine: on, off, and fault reactions.

void Cia402Servo::control(std::uint16_t word) LITHE_RT {
  const bool reset = (word & ~last_word_ & cia402::control::kFaultReset) != 0;
  last_word_ = word;
  if (state_ == State::fault) {
    const bool cause_stays = std::any_of(causes_.begin(), causes_.end(), [](std::uint16_t code) { return code != 0; });
    if (!reset || cause_stays) return;
    set_error(canopen::emergency::kGone);
    enter(State::switch_on_disabled);
    return;
  }
  if (state_ != State::fault_reaction_active && state_ != State::not_ready) handle(word);
}

// The transitions of the profile, by the lowest four bits of the word.
void Cia402Servo::handle(std::uint16_t word) LITHE_RT {
  const bool enabled = state_ == State::operation_enabled;
  const bool stopping = state_ == State::quick_stop_active;
  if ((word & 0x02) == 0 || torque_off_) return enter(State::switch_on_disabled);
  if ((word & 0x04) == 0) {  // quick stop
    if (stopping) return;
    if (!enabled || inputs_.quick_stop_option == 0) return enter(State::switch_on_disabled);
    enter(State::quick_stop_active);
    return begin_ramp();
  }
  if (stopping) {
    const bool may_go_on = inputs_.quick_stop_option >= 5 && (word & 0x0f) == cia402::control::kEnable;
    return may_go_on ? enter(State::operation_enabled) : void();
  }
  if ((word & 0x01) == 0) return enter(State::ready_to_switch_on);
  if (state_ == State::switch_on_disabled) return;
  if (state_ == State::ready_to_switch_on || (word & 0x08) == 0) return enter(State::switched_on);
  if (!enabled && cia402::is_cyclic(inputs_.mode)) enable();
}

// The control word is repeated until the state is reached.
void Cia402Servo::enable() LITHE_RT {
  if (enabling_from_ns_ == kNever) enabling_from_ns_ = time_ns_;
  if (time_ns_ - enabling_from_ns_ >= params_.enable_ns) enter(State::operation_enabled);
}

void Cia402Servo::set_torque_off(bool off) LITHE_RT {
  torque_off_ = off;
  if (off && state_ != State::fault) enter(State::switch_on_disabled);
}

void Cia402Servo::stop_at_limit() LITHE_RT {
  if (state_ != State::operation_enabled) return;
  enter(State::quick_stop_active);
  begin_ramp();
}

void Cia402Servo::fail(std::uint16_t code, bool stays) LITHE_RT {
  const auto known = std::find(causes_.begin(), causes_.end(), code);
  const auto free = std::find(causes_.begin(), causes_.end(), std::uint16_t{0});
  if (stays && known == causes_.end() && free != causes_.end()) *free = code;
  if (state_ == State::fault || state_ == State::fault_reaction_active) return;
  set_error(code);
  const bool ramp = powered() && inputs_.fault_reaction_option != 0;
  enter(ramp ? State::fault_reaction_active : State::fault);
  begin_ramp();
}

void Cia402Servo::cause_gone(std::uint16_t code) LITHE_RT {
  for (std::uint16_t& cause : causes_)
    if (code == 0 || cause == code) cause = 0;
}

void Cia402Servo::find_causes() LITHE_RT {
  for (const std::uint16_t cause : causes_)
    if (cause != 0) return fail(cause, true);
}

void Cia402Servo::connection_lost(std::int32_t option, std::uint16_t code) LITHE_RT {
  constexpr std::int32_t kFault = 1;
  constexpr std::int32_t kDisable = 2;
  constexpr std::int32_t kQuickStop = 3;
  if (option == kFault) return fail(code, false);
  if (option == kDisable && state_ != State::fault) handle(cia402::control::kDisableVoltage);
  if (option == kQuickStop && state_ == State::operation_enabled) handle(cia402::control::kQuickStop);
}

}  // namespace lithe::hal::sim
