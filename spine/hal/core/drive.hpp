// SPDX-License-Identifier: Apache-2.0
// What every drive understands, whoever made it; and what every driver does.
#pragma once

#include <cstdint>
#include <limits>
#include <numbers>
#include <string>

#include "spine/core/rt.hpp"
#include "spine/hal/core/bus.hpp"
#include "spine/hal/core/frame.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::hal {

// What the drives shall do; the joint values of a command mean something in `torque` only.
enum class DriveAction : std::uint8_t { off, torque, damp, brake };

// One joint's part of an ActuatorCommand, in joint coordinates.
struct JointCommand {
  DriveAction action = DriveAction::off;
  double torque_nm = 0;                                            // feed-forward
  double position_rad = std::numeric_limits<double>::quiet_NaN();  // of the drive's own PD loop; NaN = none
  double velocity_rad_s = 0;
  double kp_nm_rad = 0;
  double kd_nm_s_rad = 0;
  double max_torque_nm = 0;
  bool clear_fault = false;  // with `off`: a person has looked, and the drive may forget its fault
};

// No motor turns faster: beyond it an answer is noise, not a measurement.
inline constexpr double kMaxMotorRevPerS = 3000;

// How a joint turns with its motor: position_rad = sign * motor_rad / ratio + zero_rad.
struct JointTransform {
  double sign = 1.0;      // +1 or -1
  double zero_rad = 0.0;  // the joint's angle where its device reads 0
  double ratio = 1.0;     // motor turns per joint turn

  double gear() const LITHE_RT { return sign * ratio; }
  double motor_rev(double position_rad) const LITHE_RT { return (position_rad - zero_rad) * rev_per_rad(); }
  double position_rad(double motor_rev) const LITHE_RT { return motor_rev / rev_per_rad() + zero_rad; }
  double rev_per_rad() const LITHE_RT { return gear() / (2 * std::numbers::pi); }
};

// One exchange with all buses.
struct Exchange {
  std::uint64_t number = 0;  // counts from 1
  std::int64_t now_ns = 0;   // CLOCK_MONOTONIC when it began
  // Our own address changes with every exchange, and drives that answer to it show which command they answer.
  std::uint32_t source = 0;
  bool asked = false;  // the commands have left: what came before answers none of them
};

// What a drive tells of itself. NaN: this drive does not tell it, or has not yet.
struct DriveReport {
  static constexpr double kUntold = std::numeric_limits<double>::quiet_NaN();
  wire::DriveState state = wire::DriveState::off;
  double current_a = kUntold;         // in the motor's windings, signed like the joint's torque
  double voltage_v = kUntold;         // of its supply
  double power_w = kUntold;           // into its motor
  double temperature_degc = kUntold;  // of its board
};

// What a drive said about its joint, in joint coordinates.
struct JointSample {
  double position_rad = 0;
  double velocity_rad_s = 0;
  double torque_nm = 0;
  std::uint32_t status = 0;  // wire::joint_status but fresh and lost; drive fault << 8, drive mode << 16
  bool measured = false;     // the first three are finite and possible
  DriveReport drive{};
};

enum class Heard : std::uint8_t {
  answer,     // whole: the sample is filled in
  part,       // of an answer, or news that is none; kept by the driver
  late,       // the answer to an exchange that is over
  malformed,  // not a whole answer of this drive
};

// Turns a joint's command into frames, and frames into what the joint does.
// Contract: RT · no I/O but through the bus it is handed · one thread
class Drive {
 public:
  Drive() = default;
  Drive(const Drive&) = delete;
  Drive& operator=(const Drive&) = delete;
  virtual ~Drive() = default;

  // Sends what this exchange needs. A number that is not finite never leaves: the joint is damped instead, and false is
  // returned.
  virtual bool command(const JointCommand& command, const Exchange& exchange, Bus& bus) LITHE_RT = 0;

  // A frame from this drive's address. `sample` is changed by an answer only.
  virtual Heard take(const Frame& frame, const Exchange& exchange, JointSample& sample) LITHE_RT = 0;

  // Bits of wire::joint_status that it has told otherwise than by an answer: why none comes.
  virtual std::uint32_t alarm() const LITHE_RT { return 0; }

  // What keeps it from being commanded, and what to do; empty when nothing does.
  // Contract: any thread but an exchange's
  virtual std::string why_not_ready() const { return ""; }
};

// What a bus needs beside commands to its drives: SYNC, heartbeats, the network's state.
// Contract: as Drive
class BusMaster {
 public:
  BusMaster() = default;
  BusMaster(const BusMaster&) = delete;
  BusMaster& operator=(const BusMaster&) = delete;
  virtual ~BusMaster() = default;

  virtual void before_commands(const Exchange& exchange, Bus& bus) LITHE_RT = 0;
  virtual void after_commands(const Exchange& exchange, Bus& bus) LITHE_RT = 0;
};

}  // namespace lithe::hal
