// SPDX-License-Identifier: Apache-2.0
// Interface of a drive: command, sample, driver.
#pragma once

#include <cstdint>
#include <limits>
#include <numbers>
#include <string>

#include "spine/core/pd.hpp"
#include "spine/core/rt.hpp"
#include "spine/hal/core/bus.hpp"
#include "spine/hal/core/frame.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::hal {

// Action of the drives; the values of a JointCommand are used in `torque` only.
enum class DriveAction : std::uint8_t { off, torque, damp, brake };

// One joint's part of an ActuatorCommand, in joint coordinates.
struct JointCommand : Pd {
  DriveAction action = DriveAction::off;
  double max_torque_nm = 0;
  bool clear_fault = false;  // with `off`: the robot was reset, so the drive clears its fault
};

// Plausibility limit: no motor turns faster, so a larger value is not a measurement.
inline constexpr double kMaxMotorRevPerS = 3000;

// Transmission: position_rad = sign * motor_rad / ratio + zero_rad.
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
  // Our source address changes with every exchange; the answer of a moteus shows it, and so which command it belongs
  // to.
  std::uint32_t source = 0;
  bool asked = false;  // the commands are sent: earlier frames are no answers to them
};

// State reported by the drive. NaN: not reported, or not yet.
struct DriveReport {
  static constexpr double kNotReported = std::numeric_limits<double>::quiet_NaN();
  wire::DriveState state = wire::DriveState::off;
  double current_a = kNotReported;         // in the motor's windings, signed like the joint's torque
  double voltage_v = kNotReported;         // of its supply
  double power_w = kNotReported;           // into its motor
  double temperature_degc = kNotReported;  // of its board
};

// One sample of a joint, in joint coordinates.
struct JointSample {
  double position_rad = 0;
  double velocity_rad_s = 0;
  double torque_nm = 0;
  std::uint32_t status = 0;  // wire::joint_status but fresh and lost; drive fault << 8, drive mode << 16
  bool measured = false;     // position, velocity and torque are finite and plausible
  DriveReport drive{};
};

enum class ReplyKind : std::uint8_t {
  answer,     // complete: `sample` is filled in
  part,       // part of an answer, or another frame; kept by the driver
  late,       // an answer to an earlier exchange
  malformed,  // not a valid answer of this drive
};

// Driver: converts a joint's command to frames, and frames to samples.
// Contract: RT · I/O only through the bus argument · one thread
class Drive : public Interface {
 public:
  // Sends the frames of this exchange. A value that is not finite is never sent: the joint is damped instead, and false
  // is returned.
  virtual bool command(const JointCommand& command, const Exchange& exchange, Bus& bus) LITHE_RT = 0;

  // Handles a frame from this drive's address. `sample` is changed by an answer only.
  virtual ReplyKind on_frame(const Frame& frame, const Exchange& exchange, JointSample& sample) LITHE_RT = 0;

  // Bits of wire::joint_status known from other frames than answers, for example why no answer comes.
  virtual std::uint32_t alarm() const LITHE_RT { return 0; }

  // Why it cannot be commanded, and the next step; empty = ready.
  // Contract: any thread but an exchange's
  virtual std::string why_not_ready() const { return ""; }
};

// Bus master: sends SYNC and heartbeats.
// Contract: as Drive
class BusMaster : public Interface {
 public:
  virtual void before_commands(const Exchange& exchange, Bus& bus) LITHE_RT = 0;
  virtual void after_commands(const Exchange& exchange, Bus& bus) LITHE_RT = 0;
};

}  // namespace lithe::hal
