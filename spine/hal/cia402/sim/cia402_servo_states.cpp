// SPDX-License-Identifier: Apache-2.0
// State machine of a simulated drive: on, off, and fault reactions.
#include <algorithm>

#include "spine/hal/canopen/canopen.hpp"
#include "spine/hal/cia402/sim/cia402_servo.hpp"

namespace lithe::hal::sim {

using cia402::State;

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
