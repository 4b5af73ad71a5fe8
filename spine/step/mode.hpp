// SPDX-License-Identifier: Apache-2.0
// The modes of the Spine, and the commands that change between them.
#pragma once

#include "spine/core/rt.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::step {

// Conditions that decide a command's answer, besides the mode.
struct Conditions {
  bool has_law = false;        // a law is resident and may step
  bool sample_fresh = false;   // every joint answered in the last exchange, at most 3 ticks ago, and no drive reports a
                               // fault; if disarmed, every drive was also sent "off"
  bool drive_fault = false;    // a drive reports a fault
  bool homed = true;           // every joint that must be homed is
  bool estop_pressed = false;  // one of the sticky words is set
  bool inside = true;          // every joint is at most Recovery::kAtLimitRad beyond its position limits
  bool memory_whole = true;    // contain::Constants found no change
  bool moves = false;          // a joint moves: the safe law brakes it before the drives are switched off
  bool law_marked = false;     // the law has stopped the robot, and the command does not say "all the same"
};

//   arm      disarmed, hold -> active
//   hold     active -> hold
//   disarm   active, hold, recover, safe_stop -> disarmed; while a joint moves: first safe_stop, until it rests
//   fault    active, hold, recover -> safe_stop
//   e-stop   any mode -> estop
//   reset    wherever a fault is latched -> disarmed, as `disarm`; also in disarmed while a drive reports a fault, to
//            clear that
//   recover  disarmed -> recover; also from a safe stop by position_limit, velocity_limit or recover_failed, so that a
//            held joint does not have to be switched off first. Ends with disarm, a fault, or with arm once every joint
//            is inside its limits.
// estop is left only by reset. safe_stop is left by reset, by recover (above) or by disarm; after disarm its fault
// stays latched until reset. None of them starts a law. The fault of one group, while other groups continue, is latched
// as well and does not change the mode. Once memory is damaged, only a new process can move the robot again.
// Contract: RT · owned by the tick thread
class ModeMachine {
 public:
  wire::Mode mode() const LITHE_RT { return mode_; }
  wire::Fault fault() const LITHE_RT { return fault_; }
  bool energised() const LITHE_RT { return mode_ != wire::Mode::disarmed && mode_ != wire::Mode::estop; }
  // In the e-stop: true when the drives had torque before it. Drives that were off stay off: someone may be holding the
  // joints.
  bool damps() const LITHE_RT { return mode_ == wire::Mode::estop && was_energised_; }
  bool law_runs() const LITHE_RT { return mode_ == wire::Mode::active || mode_ == wire::Mode::hold; }
  bool can_fail() const LITHE_RT { return law_runs() || mode_ == wire::Mode::recover; }
  // In a safe stop that ends with switch_off(), because `disarm` or `reset` came while a joint moved.
  bool brakes() const LITHE_RT { return mode_ == wire::Mode::safe_stop && off_at_rest_; }
  void switch_off() LITHE_RT { mode_ = wire::Mode::disarmed; }

  // Applies one of arm, disarm, hold, reset, recover, estop; anything else is refused_unknown.
  wire::CommandResult apply(wire::CommandKind kind, const Conditions& conditions) LITHE_RT;

  // A fault of the running robot: enters the latched safe stop. Ignored except in the modes active, hold and recover.
  // True if the mode changed.
  bool fail(wire::Fault fault) LITHE_RT;
  void fail_in_part(wire::Fault fault) LITHE_RT;

  // The e-stop has priority over everything. True if the mode changed.
  bool press_estop() LITHE_RT;

 private:
  wire::CommandResult arm(const Conditions& conditions) LITHE_RT;
  wire::CommandResult reset(const Conditions& conditions) LITHE_RT;
  void off(const Conditions& conditions) LITHE_RT;
  wire::CommandResult recover(const Conditions& conditions) LITHE_RT;

  wire::Mode mode_ = wire::Mode::disarmed;
  wire::Fault fault_ = wire::Fault::none;
  bool was_energised_ = false;  // before the e-stop
  bool off_at_rest_ = false;    // of the safe stop
};

}  // namespace lithe::step
