// SPDX-License-Identifier: Apache-2.0
// Who may do what when: the modes of the Spine and the commands that move between them.
#pragma once

#include <cstdint>

#include "spine/core/rt.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::loop {

// What a command's answer depends on besides the mode.
struct Conditions {
  bool has_law = false;        // a law is resident and may step
  bool sample_fresh = false;   // every joint has answered in this tick
  bool homed = true;           // every joint that must be homed is
  bool estop_pressed = false;  // one of the sticky words is set
  bool inside = true;          // every joint is within its position limits
  bool memory_whole = true;    // no constant of this process was found changed
};

// disarmed --arm--> active <--arm/hold--> hold;  disarm: from active, hold and safe_stop;
// fault: active, hold, recover --> safe_stop;  e-stop: from anywhere --> estop;  reset: wherever a fault is latched -->
// disarmed. safe_stop and estop are latched: only a reset leaves them, and never straight into motion. A fault
// of a part of the robot, without which the rest goes on, is latched as well and leaves the mode alone.
// recover: from disarmed, and from a safe stop whose fault it is the way out of (position_limit, velocity_limit,
// recover_failed), so that a joint that is held there need not fall first. It ends with disarm, a fault, or with arm
// once every joint is inside. Once memory is damaged there is no way back into motion but a new process.
// Contract: RT · owned by the tick thread
class ModeMachine {
 public:
  wire::Mode mode() const LITHE_RT { return mode_; }
  wire::Fault fault() const LITHE_RT { return fault_; }
  bool energised() const LITHE_RT { return mode_ != wire::Mode::disarmed && mode_ != wire::Mode::estop; }
  // In the e-stop: the drives had torque when it was pressed. Others stay off, whoever has his hands on the joints.
  bool damps() const LITHE_RT { return mode_ == wire::Mode::estop && was_energised_; }
  bool law_runs() const LITHE_RT { return mode_ == wire::Mode::active || mode_ == wire::Mode::hold; }
  bool can_fail() const LITHE_RT { return law_runs() || mode_ == wire::Mode::recover; }

  // Applies one of arm, disarm, hold, reset, recover, estop; anything else is refused_unknown.
  wire::CommandResult apply(wire::CommandKind kind, const Conditions& conditions) LITHE_RT;

  // A fault of the running robot: into the latched safe stop. Ignored where nothing is driven. True if the mode
  // changed.
  bool fail(wire::Fault fault) LITHE_RT;
  void fail_in_part(wire::Fault fault) LITHE_RT;

  // The e-stop wins over everything. True if the mode changed.
  bool press_estop() LITHE_RT;

 private:
  wire::CommandResult arm(const Conditions& conditions) LITHE_RT;
  wire::CommandResult reset(const Conditions& conditions) LITHE_RT;
  wire::CommandResult recover(const Conditions& conditions) LITHE_RT;

  wire::Mode mode_ = wire::Mode::disarmed;
  wire::Fault fault_ = wire::Fault::none;
  bool was_energised_ = false;  // before the e-stop
};

}  // namespace lithe::loop
