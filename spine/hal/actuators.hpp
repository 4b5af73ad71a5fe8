// SPDX-License-Identifier: Apache-2.0
// One memory map over all hardware: the only thing the loop knows of motors.
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <memory>
#include <string>
#include <vector>

#include "spine/core/joints.hpp"
#include "spine/core/result.hpp"
#include "spine/core/rt.hpp"
#include "spine/hal/bus/pi3hat_port.hpp"
#include "spine/hal/bus/tap.hpp"
#include "spine/hal/device/drive.hpp"
#include "spine/robot/config.hpp"

namespace lithe::hal {

// One command for the whole robot, in joint coordinates (after sign, zero and ratio). The first `joints` entries count.
struct ActuatorCommand {
  std::uint64_t tick = 0;
  std::uint32_t joints = 0;
  std::array<DriveAction, kMaxJoints> action{};
  bool clear_faults = false;      // a person has reset the robot: drives that are off may forget theirs
  bool reset_simulation = false;  // simulated joints are put back to where they began; real ones know nothing of it
  JointArray torque_nm{};         // feed-forward
  JointArray position_rad{};      // of the drive's own PD loop; NaN = none
  JointArray velocity_rad_s{};
  JointArray kp_nm_rad{};
  JointArray kd_nm_s_rad{};
  JointArray max_torque_nm{};

  void act(DriveAction all) LITHE_RT { action.fill(all); }
};

// What came back. A joint that did not answer keeps its last values and loses its `fresh` bit.
struct ActuatorState {
  std::uint64_t tick = 0;      // of the command that was answered
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

// Everything that went otherwise than one command, one answer; since the start.
struct ReplyCounters {
  std::uint64_t missed = 0;     // a joint was asked and did not answer in its exchange
  std::uint64_t late = 0;       // answers that came after their exchange was over; never used
  std::uint64_t duplicate = 0;  // a second answer in one exchange, a sensor frame that was there; the first one counts
  std::uint64_t conflicting = 0;  // a second one that says something else; none counts
  std::uint64_t stray = 0;        // from no device of ours
  std::uint64_t malformed = 0;    // not a whole answer, or no possible measurement
  std::uint64_t unsound = 0;      // commands that were not finite: the joint was damped instead
  std::uint64_t refused = 0;      // commands a bus had no room for
};

// Contract: RT as far as the bus is · called by one thread, once per tick · bounded
class Actuators {
 public:
  virtual ~Actuators() = default;
  // Sends `command`, collects the replies into `state`. `now_ns` is CLOCK_MONOTONIC: simulated devices live by it.
  virtual void cycle(const ActuatorCommand& command, ActuatorState& state, std::int64_t now_ns) LITHE_RT = 0;
  // For the thread that cycles, or after its end.
  virtual const ReplyCounters& counters() const LITHE_RT = 0;

  // Others need this thread's core, too: it sleeps while it waits for answers, instead of looking all the time.
  // Contract: before the first cycle
  virtual void share_core() {}

  // Brings back buses whose hardware went away.
  // Contract: not RT · one other thread, about once a second
  virtual void service() {}
  // Which bus is down and which drive not ready, and why; empty when all is well.
  // Contract: as service()
  virtual std::string trouble() const { return ""; }
  // What real buses carried otherwise than asked, a clause each; empty when nothing.
  // Contract: after the last cycle
  virtual std::string tell_buses() const { return ""; }
};

// Opens every bus and device of the robot. `pi3hat`: what stands in for the board; null = the one of this machine.
// `tap` sees the frames of all buses by their number in the file; null = nobody.
// Contract: never in the tick
Result<std::unique_ptr<Actuators>> open_actuators(const robot::RobotConfig& config,
                                                  std::unique_ptr<Pi3hatPort> pi3hat = nullptr,
                                                  FrameTap* tap = nullptr);

class BusNode;

// The same robot with every bus and device simulated, whatever the file says.
// Contract: never in the tick `far_ends`: for each bus the devices at its other end, which outlive the actuators; empty
// = made to fit.
Result<std::unique_ptr<Actuators>> simulate_actuators(robot::RobotConfig config,
                                                      const std::vector<BusNode*>& far_ends = {});

}  // namespace lithe::hal
