// SPDX-License-Identifier: Apache-2.0
// One interface to all hardware: the loop includes only this. Made by robot_hardware.hpp.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <string>

#include "spine/core/joints.hpp"
#include "spine/core/pd.hpp"
#include "spine/core/rt.hpp"
#include "spine/hal/core/drive.hpp"
#include "spine/robot/config.hpp"

namespace lithe::hal {

// One command for the whole robot, in joint coordinates (after sign, zero and ratio). The first `joints` entries count.
struct ActuatorCommand : JointCommands {
  std::uint64_t tick = 0;
  std::uint32_t joints = 0;
  std::array<DriveAction, kMaxJoints> action{};
  bool clear_faults = false;      // after `reset`: drives that are off clear their faults
  bool reset_simulation = false;  // simulated joints go back to their start; real ones ignore it

  void act(DriveAction all) LITHE_RT { action.fill(all); }
};

// The samples. A joint that did not answer keeps its last values and loses its `fresh` bit.
struct ActuatorState {
  std::uint64_t tick = 0;      // the tick of the answered command
  std::int64_t sample_ns = 0;  // CLOCK_MONOTONIC when the exchange began
  std::uint32_t joints = 0;
  std::int64_t bus_ns = 0;  // length of the exchange
  JointArray position_rad{};
  JointArray velocity_rad_s{};
  JointArray torque_nm{};
  std::array<std::uint32_t, kMaxJoints> status{};  // wire::joint_status bits, drive fault << 8, drive mode << 16
  std::array<DriveReport, kMaxJoints> drive{};
  std::uint32_t sensors = 0;
  std::array<double, robot::kMaxSensors> sensor = none_valid();  // in the units of robot.toml; NaN = not valid

  static constexpr std::array<double, robot::kMaxSensors> none_valid() LITHE_RT {
    std::array<double, robot::kMaxSensors> none{};
    none.fill(std::numeric_limits<double>::quiet_NaN());
    return none;
  }
};

// Counters of every deviation from "one command, one answer"; since the start.
struct ReplyCounters {
  std::uint64_t missed = 0;       // a joint was asked and did not answer in its exchange
  std::uint64_t late = 0;         // answers that came after their exchange was over; never used
  std::uint64_t duplicate = 0;    // second equal answers, repeated sensor frames; the first one is used
  std::uint64_t conflicting = 0;  // a second answer that differs; neither is used
  std::uint64_t stray = 0;        // from a device that is not in the robot file
  std::uint64_t malformed = 0;    // incomplete answers, or impossible measurements
  std::uint64_t unsound = 0;      // commands that were not finite: the joint was damped instead
  std::uint64_t refused = 0;      // commands that a bus had no room for
};

// Contract: RT as far as the bus is · called by one thread, once per tick · bounded
class Actuators {
 public:
  virtual ~Actuators() = default;
  // Sends `command`, collects the replies into `state`. `now_ns` is CLOCK_MONOTONIC; it is the time of simulated
  // devices.
  virtual void cycle(const ActuatorCommand& command, ActuatorState& state, std::int64_t now_ns) LITHE_RT = 0;
  // Call from the thread that calls cycle(), or after its end.
  virtual const ReplyCounters& counters() const LITHE_RT = 0;

  // The core is shared: sleep while waiting for answers, instead of polling.
  // Contract: before the first cycle
  virtual void share_core() {}

  // Reopens buses whose hardware was lost.
  // Contract: not RT · one other thread, about once a second
  virtual void service() {}
  // Which bus is down and which drive is not ready, with the reason; empty = none.
  // Contract: as service()
  virtual std::string why_not_ready() const { return ""; }
  // Deviations on real buses, one clause each; empty = none.
  // Contract: after the last cycle
  virtual std::string tell_buses() const { return ""; }
};

}  // namespace lithe::hal
