// SPDX-License-Identifier: Apache-2.0
// What drives say of themselves in numbers, in words.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "spine/robot/config.hpp"

namespace lithe::bus {

// From bits 8 to 23 of a joint's status (wire::joint_status): its drive's mode or state, and what is wrong or at its
// limit, with the code to look up: "fault: over-temperature (38)". Empty for what is no drive.
// Contract: pure
std::string drive_words(robot::DeviceKind kind, std::uint32_t joint_status);

// What a CANopen emergency is about, by the code's class where the code itself is not known; never empty.
std::string_view emergency_name(std::uint16_t code);

}  // namespace lithe::bus
