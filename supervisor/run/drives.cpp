// SPDX-License-Identifier: Apache-2.0
#include "supervisor/run/drives.hpp"

#include <algorithm>
#include <cstddef>

namespace lithe::control {
namespace {

// Mode numbers of a moteus (register 0x000).
Drives moteus_in(std::uint32_t mode) {
  switch (mode) {
    case 0:  // stopped
    case 1:  // stopped by a fault
      return Drives::off;
    case 11:  // watchdog timeout
    case 12:  // zero velocity
    case 15:  // brake
      return Drives::damped;
    default:
      return Drives::driven;
  }
}

// State numbers of the CiA 402 driver. In "ready to switch on" and "switched on" the motor has no torque yet.
Drives cia402_in(std::uint32_t state) {
  switch (state) {
    case 0:  // not ready
    case 1:  // switch on disabled
    case 2:  // ready to switch on
    case 3:  // switched on
    case 7:  // fault
      return Drives::off;
    case 5:  // quick stop
    case 6:  // fault reaction active
      return Drives::damped;
    default:
      return Drives::driven;
  }
}

Drives drive_of(const robot::RobotConfig& robot, const wire::Telemetry& now, std::size_t joint) {
  const std::uint32_t status = now.joint_status[joint];
  if ((status & wire::joint_status::kFresh) == 0 || joint >= robot.joints.size() ||
      robot.joints[joint].device >= robot.devices.size()) {
    return Drives::driven;
  }
  const std::uint32_t mode = status >> 16 & 0xFFU;
  const bool canopen = robot.devices[robot.joints[joint].device].kind == robot::DeviceKind::cia402;
  return canopen ? cia402_in(mode) : moteus_in(mode);
}

std::size_t joints_of(const wire::Telemetry& now) { return std::min<std::size_t>(now.joint_count, wire::kNj); }

}  // namespace

Drives drives_of(const robot::RobotConfig& robot, const wire::Telemetry& now) {
  Drives least = joints_of(now) == 0 ? Drives::driven : Drives::off;
  for (std::size_t j = 0; j < joints_of(now); ++j) {
    least = std::min(least, drive_of(robot, now, j));
  }
  return least;
}

std::string joints_not_off(const robot::RobotConfig& robot, const wire::Telemetry& now) {
  std::string names;
  for (std::size_t j = 0; j < std::min(joints_of(now), robot.joints.size()); ++j) {
    if (drive_of(robot, now, j) != Drives::off) {
      names += (names.empty() ? "" : ", ") + robot.joints[j].name;
    }
  }
  return names;
}

}  // namespace lithe::control
