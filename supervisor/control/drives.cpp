// SPDX-License-Identifier: Apache-2.0
#include "supervisor/control/drives.hpp"

#include <algorithm>
#include <cstddef>

#include "supervisor/control/spine_link.hpp"

namespace lithe::control {
namespace {

constexpr std::size_t kNameWidth = 32;

// The drive's own mode, as its registers number it.
Drives drive_of(std::uint32_t status) {
  if ((status & wire::joint_status::kFresh) == 0) {
    return Drives::driven;
  }
  switch (status >> 16 & 0xFFU) {
    case 0:  // stopped
    case 1:  // stopped by a fault
      return Drives::off;
    case 11:  // its watchdog ran out
    case 12:  // zero velocity
    case 15:  // brake
      return Drives::damped;
    default:
      return Drives::driven;
  }
}

std::size_t joints_of(const wire::Telemetry& now) { return std::min<std::size_t>(now.joint_count, wire::kNj); }

}  // namespace

Drives drives_of(const wire::Telemetry& now) {
  Drives least = joints_of(now) == 0 ? Drives::driven : Drives::off;
  for (std::size_t j = 0; j < joints_of(now); ++j) {
    least = std::min(least, drive_of(now.joint_status[j]));
  }
  return least;
}

std::string joints_not_off(const wire::RobotInfo& info, const wire::Telemetry& now) {
  std::string names;
  for (std::size_t j = 0; j < joints_of(now); ++j) {
    if (drive_of(now.joint_status[j]) != Drives::off) {
      names += (names.empty() ? "" : ", ") + text_of(info.joint_name, j * kNameWidth, kNameWidth);
    }
  }
  return names;
}

}  // namespace lithe::control
