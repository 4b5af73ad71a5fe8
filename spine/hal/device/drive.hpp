// SPDX-License-Identifier: Apache-2.0
// What every drive understands, whoever made it.
#pragma once

#include <cstdint>
#include <limits>
#include <numbers>

#include "spine/core/rt.hpp"

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
};

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

}  // namespace lithe::hal
