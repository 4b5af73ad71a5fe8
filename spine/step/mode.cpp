// SPDX-License-Identifier: Apache-2.0
#include "spine/step/mode.hpp"

namespace lithe::step {

using wire::CommandKind;
using wire::CommandResult;
using wire::Fault;
using wire::Mode;

namespace {

// The faults from which `recover` is allowed.
bool leaves_by_recover(Fault fault) LITHE_RT {
  return fault == Fault::none || fault == Fault::position_limit || fault == Fault::velocity_limit ||
         fault == Fault::recover_failed;
}

}  // namespace

CommandResult ModeMachine::apply(CommandKind kind, const Conditions& conditions) LITHE_RT {
  switch (kind) {
    case CommandKind::arm:
      return arm(conditions);
    case CommandKind::reset:
      return reset(conditions);
    case CommandKind::recover:
      return recover(conditions);
    case CommandKind::disarm:
      // Only `reset` leaves the e-stop.
      if (mode_ == Mode::estop) return CommandResult::refused_estop;
      off(conditions);  // a fault stays latched: it takes a reset before the next arming
      return CommandResult::done;
    case CommandKind::hold:
      if (!law_runs()) return CommandResult::refused_mode;
      mode_ = Mode::hold;
      return CommandResult::done;
    case CommandKind::estop:
      press_estop();
      return CommandResult::done;
    default:
      return CommandResult::refused_unknown;
  }
}

CommandResult ModeMachine::arm(const Conditions& conditions) LITHE_RT {
  if (conditions.estop_pressed || mode_ == Mode::estop) return CommandResult::refused_estop;
  if (!conditions.memory_whole) return CommandResult::refused_damaged;
  if (brakes()) return CommandResult::refused_mode;
  if (fault_ != Fault::none && !law_runs()) return CommandResult::refused_fault;
  if (!conditions.has_law) return CommandResult::refused_law;
  if (conditions.law_marked && !law_runs()) return CommandResult::refused_marked;
  if (!conditions.sample_fresh) return CommandResult::refused_not_ready;
  if (!conditions.homed) return CommandResult::refused_not_homed;
  if (!conditions.inside) return CommandResult::refused_outside;
  mode_ = Mode::active;
  return CommandResult::done;
}

CommandResult ModeMachine::recover(const Conditions& conditions) LITHE_RT {
  if (conditions.estop_pressed || mode_ == Mode::estop) return CommandResult::refused_estop;
  if (!conditions.memory_whole) return CommandResult::refused_damaged;
  if (law_runs() || brakes()) return CommandResult::refused_mode;
  if (!leaves_by_recover(fault_)) return CommandResult::refused_fault;
  if (!conditions.sample_fresh) return CommandResult::refused_not_ready;
  if (!conditions.homed) return CommandResult::refused_not_homed;
  mode_ = Mode::recover;
  fault_ = Fault::none;
  return CommandResult::done;
}

CommandResult ModeMachine::reset(const Conditions& conditions) LITHE_RT {
  if (conditions.estop_pressed) return CommandResult::refused_estop;
  const bool of_drive = mode_ == Mode::disarmed && conditions.drive_fault;
  if (fault_ == Fault::none && !of_drive) return CommandResult::refused_mode;
  off(conditions);
  fault_ = Fault::none;
  return CommandResult::done;
}

// Drives that only damp, as in the e-stop, do not brake again.
void ModeMachine::off(const Conditions& conditions) LITHE_RT {
  off_at_rest_ = energised() && conditions.moves;
  mode_ = off_at_rest_ ? Mode::safe_stop : Mode::disarmed;
}

bool ModeMachine::fail(Fault fault) LITHE_RT {
  if (!can_fail()) return false;
  mode_ = Mode::safe_stop;
  off_at_rest_ = false;
  fault_ = fault;  // the fault of the whole robot; the guard has each joint's own
  return true;
}

void ModeMachine::fail_in_part(Fault fault) LITHE_RT {
  if (law_runs() && fault_ == Fault::none) fault_ = fault;
}

bool ModeMachine::press_estop() LITHE_RT {
  if (mode_ == Mode::estop) return false;
  was_energised_ = energised();
  mode_ = Mode::estop;
  fault_ = Fault::estop_pressed;
  return true;
}

}  // namespace lithe::step
