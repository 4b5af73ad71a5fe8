// SPDX-License-Identifier: Apache-2.0
// Text for the numbers that devices report.
#pragma once

#include <cstdint>
#include <string>

#include "spine/hal/registry.hpp"

namespace lithe::bus {

// Text for bits 8 to 23 of a joint's status (wire::joint_status): the drive's mode or state, and its fault or limit
// with the code, for example "fault: over-temperature (38)". Empty for a device that is not a drive.
// Contract: pure
inline std::string drive_words(robot::DeviceKind kind, std::uint32_t joint_status) {
  const auto words = hal::type_of(kind).state_words;
  return words == nullptr ? "" : words(joint_status >> 16 & 0xff, joint_status >> 8 & 0xff);
}

}  // namespace lithe::bus
