// SPDX-License-Identifier: Apache-2.0
// The driver of one moteus: joint command to frame, frame to joint sample. No I/O: a bus carries the frames.
#pragma once

#include <cstdint>

#include "spine/core/rt.hpp"
#include "spine/hal/bus/frame.hpp"
#include "spine/hal/device/drive.hpp"
#include "spine/hal/device/moteus_codec.hpp"

namespace lithe::hal::moteus {

struct DriverParams {
  std::uint32_t id = 1;     // 1 to 126
  double watchdog_s = 0.1;  // no command for this long, and the drive damps by itself
  JointTransform joint;
  // Gains the drive itself is configured with: a command scales them.
  double kp_nm_rev = 4.0;
  double kd_nm_s_rev = 0.05;
};

// What a drive said about its joint, in joint coordinates.
struct Answer {
  double position_rad = 0;
  double velocity_rad_s = 0;
  double torque_nm = 0;
  std::uint8_t mode = 0;
  std::uint8_t fault = 0;
  bool measured = false;  // the three above are finite and possible; a drive without an encoder answers NaN
  bool homed = false;     // the drive knows in which turn the joint is
};

// wire::joint_status bits of an answer: fault, watchdog, not_homed, the fault code and the mode.
std::uint32_t status_of(const Answer& sample) LITHE_RT;

// The device that sent an answer, and the source address of the command it answers.
constexpr std::uint32_t device_of(const Frame& answer) LITHE_RT { return answer.id >> 8; }
constexpr std::uint32_t source_of(const Frame& answer) LITHE_RT { return answer.id & 0xff; }

// Every frame is a complete command (writing the mode resets all that was commanded before), carries its own watchdog
// and asks for the same answer, so that a lost frame loses nothing but itself. 48 bytes there, 24 back.
// Contract: RT · pure · any thread
class Driver {
 public:
  explicit Driver(const DriverParams& params) : params_(params) {}

  std::uint32_t id() const LITHE_RT { return params_.id; }

  // A number that is not finite never leaves here: the joint is damped instead, and false is returned.
  // `source` is our own address (0 to 127). The drive answers to it, so whoever changes it with every exchange knows an
  // answer that is late: nothing else in an answer tells which command it belongs to.
  bool encode(const JointCommand& command, std::uint32_t source, Frame& frame) const LITHE_RT;

  // False: not a whole answer of this drive; `sample` is unchanged. Whom it answers is left to the caller (source_of).
  bool decode(const Frame& frame, Answer& sample) const LITHE_RT;

 private:
  void write_torque(const JointCommand& command, SubframeWriter& writer) const LITHE_RT;

  DriverParams params_;
};

}  // namespace lithe::hal::moteus
