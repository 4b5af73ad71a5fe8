// SPDX-License-Identifier: Apache-2.0
// Compares two robot files by what they say: RobotConfig::values.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

namespace lithe::robot {

// FNV-1a. Notices a change; it does not protect against a file that was made to have the same hash.
std::uint64_t values_hash(std::string_view values);

// The keys whose values differ, one a line, twelve at most: "  [[joint]] shoulder: torque_max_nm = 0.3, and there 0.6".
// Empty when all are equal.
std::string values_difference(std::string_view here, std::string_view there);

}  // namespace lithe::robot
