// SPDX-License-Identifier: Apache-2.0
#include "supervisor/run/drives.hpp"

#include <algorithm>
#include <cstddef>

namespace lithe::control {
namespace {

// An unknown number, and `enabling`, in which a motor may already turn, count as driven.
Drives drive_of(const wire::Telemetry& now, std::size_t joint) {
  if ((now.joint_status[joint] & wire::joint_status::kFresh) == 0) return Drives::driven;
  switch (static_cast<wire::DriveState>(now.drive_state[joint])) {
    case wire::DriveState::off:
    case wire::DriveState::fault:
      return Drives::off;
    case wire::DriveState::damped:
      return Drives::damped;
    case wire::DriveState::enabling:
    case wire::DriveState::driven:
      break;
  }
  return Drives::driven;
}

std::size_t joints_of(const wire::Telemetry& now) { return std::min<std::size_t>(now.joint_count, wire::kNj); }

}  // namespace

Drives drives_of(const wire::Telemetry& now) {
  Drives least = joints_of(now) == 0 ? Drives::driven : Drives::off;
  for (std::size_t j = 0; j < joints_of(now); ++j) least = std::min(least, drive_of(now, j));
  return least;
}

std::string joints_not_off(const robot::RobotConfig& robot, const wire::Telemetry& now) {
  std::string names;
  for (std::size_t j = 0; j < std::min(joints_of(now), robot.joints.size()); ++j)
    if (drive_of(now, j) != Drives::off) names += (names.empty() ? "" : ", ") + robot.joints[j].name;
  return names;
}

}  // namespace lithe::control
