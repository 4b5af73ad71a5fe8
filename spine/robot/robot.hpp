// SPDX-License-Identifier: Apache-2.0
// Reads robot.toml. Every mistake is reported with its place, the nearest right word and what to do next.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "spine/core/result.hpp"
#include "spine/robot/config.hpp"

namespace lithe::robot {

// What a bus may be set to [bit/s]. Of CAN FD's data, 0 = classic CAN only; else it is no slower than the rest.
inline constexpr std::uint32_t kLeastBitrate = 10'000;
inline constexpr std::uint32_t kMostBitrate = 1'000'000;
inline constexpr std::uint32_t kMostDataBitrate = 8'000'000;

// Contract: never in the tick · reads one file, changes nothing. The error names every mistake of the file, one a
// line, as `file:line:column: what is wrong; what to do`. What the file costs is a note in the result; which cores
// the machine has is cpu_plan.hpp's to judge.
Result<RobotConfig> load_robot(const std::string& path);

// The same on text that is already in memory; `path` is only used in messages and to resolve relative paths.
Result<RobotConfig> parse_robot(std::string_view text, const std::string& path);

}  // namespace lithe::robot
