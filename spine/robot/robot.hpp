// SPDX-License-Identifier: Apache-2.0
// Reads robot.toml. Every error is reported with its position, the nearest known word and the next step.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "spine/core/result.hpp"
#include "spine/robot/config.hpp"

namespace lithe::robot {

// Allowed bit rates [bit/s]. Data bit rate of CAN FD: 0 = classic CAN only, otherwise not below `bitrate`.
inline constexpr std::uint32_t kLeastBitrate = 10'000;
inline constexpr std::uint32_t kMostBitrate = 1'000'000;
inline constexpr std::uint32_t kMostDataBitrate = 8'000'000;

// Contract: never in the tick · reads one file, changes nothing. The error names every mistake of the file, one a line,
// as `file:line:column: what is wrong; what to do`. Disadvantages of the settings are notes in the result. The
// machine's cores are checked in cpu_plan.hpp.
Result<RobotConfig> load_robot(const std::string& path);

// The same on text that is already in memory; `path` is only used in messages and to resolve relative paths.
Result<RobotConfig> parse_robot(std::string_view text, const std::string& path);

}  // namespace lithe::robot
