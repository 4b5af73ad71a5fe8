// SPDX-License-Identifier: Apache-2.0
// Drives one joint through a moteus: joint values to a frame, a reply to joint values. Pure: the bus is the caller's.
#pragma once

#include <cstdint>

#include "spine/core/rt.hpp"
#include "spine/hal/actuators.hpp"
#include "spine/hal/bus/bus.hpp"
#include "spine/hal/device/moteus_codec.hpp"

namespace lithe::hal {

// How a joint sits on its motor: position_rad = sign * motor_rad / ratio + zero_rad, torque_nm = sign * ratio * motor_nm.
struct JointMap {
  double sign = 1.0;
  double zero_rad = 0.0;
  double ratio = 1.0;

  double motor_rev(double position_rad) const LITHE_RT;
  double motor_rev_s(double velocity_rad_s) const LITHE_RT;
  double motor_nm(double torque_nm) const LITHE_RT { return sign * torque_nm / ratio; }
  double position_rad(double motor_rev) const LITHE_RT;
  double velocity_rad_s(double motor_rev_s) const LITHE_RT;
  double torque_nm(double motor_nm) const LITHE_RT { return sign * motor_nm * ratio; }
};

// What the driver must know of its device. Gains are the servo's own configuration, which a command scales.
struct MoteusSettings {
  std::uint8_t id = 1;
  double watchdog_s = 0.1;
  double servo_kp_nm_rev = 4.0;
  double servo_kd_nm_s_rev = 0.05;
  JointMap map;
};

// What one joint shall do, in joint coordinates (ActuatorCommand, one column of it).
struct JointCommand {
  DriveAction action = DriveAction::off;
  double torque_nm = 0, position_rad = 0, velocity_rad_s = 0, kp_nm_rad = 0, kd_nm_s_rad = 0, max_torque_nm = 0;
};

struct JointReading {
  double position_rad = 0, velocity_rad_s = 0, torque_nm = 0;
  std::uint32_t status = 0;  // wire::joint_status bits but `lost`, drive fault << 8, drive mode << 16
};

// Every frame is a complete command: the mode first (it resets all command fields), then every field that must not be
// the default, the watchdog among them, then the query.
// Contract: RT · pure
class MoteusDriver {
 public:
  explicit MoteusDriver(const MoteusSettings& settings) : settings_(settings) {}

  void encode(const JointCommand& command, Frame& frame) const LITHE_RT;

  // True if `frame` is this device's reply and `reading` is whole and finite; otherwise `reading` is untouched.
  bool decode(const Frame& frame, JointReading& reading) const LITHE_RT;

 private:
  void encode_torque(const JointCommand& command, moteus::Writer& writer) const LITHE_RT;
  MoteusSettings settings_;
};

}  // namespace lithe::hal
