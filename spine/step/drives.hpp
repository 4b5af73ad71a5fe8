// SPDX-License-Identifier: Apache-2.0
// The part of a command that the guard does not decide: torque, damping, brake or off; clear a fault; reset a
// simulation.
#pragma once

#include <algorithm>
#include <cstdint>

#include "spine/core/rt.hpp"
#include "spine/guard/guard.hpp"
#include "spine/hal/actuators.hpp"
#include "spine/robot/config.hpp"
#include "spine/step/mode.hpp"

namespace lithe::step {

// Every drive gets at least one command in this many ticks.
inline std::uint32_t slowest_drive(const robot::RobotConfig& robot) {
  std::uint32_t divider = 1;
  for (const robot::DeviceConfig& device : robot.devices) divider = std::max(divider, device.rate_divider);
  return divider;
}

// Contract: RT · owned by the step
class Drives {
 public:
  explicit Drives(const robot::RobotConfig& robot)
      : slowest_(slowest_drive(robot)), simulated_(std::ranges::none_of(robot.buses, robot::is_real)) {}

  bool simulated() const LITHE_RT { return simulated_; }  // every bus is simulated

  // To be called when the last command was sent.
  void dispatched() LITHE_RT { ticks_off_ = all_off_ ? ticks_off_ + 1 : 0; }
  // True once every drive has been sent "off".
  bool got_off() const LITHE_RT { return ticks_off_ >= slowest_; }

  // Sends clear-fault with the next "off" commands. Some drives need several.
  void clear_faults() LITHE_RT { clear_ticks_left_ = kTurnsToClear * slowest_; }
  // Sends it with the next command.
  void reset_simulation() LITHE_RT { reset_simulation_ = true; }

  // Fills in `command`, except the guard's values.
  void compose(const Tick& in, const ModeMachine& mode, const guard::Guard& guard, hal::ActuatorCommand& command)
      LITHE_RT {
    command.tick = in.tick + 1;
    command.joints = in.joints;
    command.clear_faults = clear_ticks_left_ > 0 && mode.mode() == wire::Mode::disarmed;
    // A reset may brake first, and clears when the drives are off. A later fault needs another reset.
    if (!mode.brakes()) clear_ticks_left_ = command.clear_faults ? clear_ticks_left_ - 1 : 0;
    command.reset_simulation = reset_simulation_;
    reset_simulation_ = false;
    all_off_ = !mode.energised() && !mode.damps();
    for (std::uint32_t j = 0; j < in.joints; ++j)
      command.action[j] = all_off_ ? hal::DriveAction::off : action_of(guard.rung(j), mode);
  }

 private:
  static constexpr std::uint32_t kTurnsToClear = 200;

  static hal::DriveAction action_of(wire::Rung rung, const ModeMachine& mode) LITHE_RT {
    switch (rung) {  // the e-stop only goes down the ladder
      case wire::Rung::brake:
        return hal::DriveAction::brake;
      case wire::Rung::off:
        return hal::DriveAction::off;
      default:
        return mode.damps() ? hal::DriveAction::damp : hal::DriveAction::torque;
    }
  }

  std::uint32_t slowest_;
  bool simulated_;
  std::uint32_t clear_ticks_left_ = 0;  // since the last reset
  bool reset_simulation_ = false;
  bool all_off_ = true;          // the next command is "off" for all
  std::uint64_t ticks_off_ = 0;  // such commands sent in a row
};

}  // namespace lithe::step
