// SPDX-License-Identifier: Apache-2.0
// Which control loop of a joint its drive closes by itself.
#pragma once

#include <cstdint>

#include "spine/robot/config.hpp"

namespace lithe::robot {

// torque: the drive takes a torque, and adds the PD of its command. velocity, position: it moves to the command's
// target by its own control; a torque is only an offset, which its loop works against.
enum class DriveLoop : std::uint8_t { torque, velocity, position };

// Contract: pure
inline DriveLoop loop_of(const RobotConfig& robot, const JointConfig& joint) {
  if (joint.device >= robot.devices.size() || robot.devices[joint.device].kind != DeviceKind::cia402)
    return DriveLoop::torque;
  switch (robot.devices[joint.device].keys.cia402.mode) {
    case hal::cia402::Mode::position:
      return DriveLoop::position;
    case hal::cia402::Mode::velocity:
      return DriveLoop::velocity;
    default:
      return DriveLoop::torque;
  }
}

}  // namespace lithe::robot
