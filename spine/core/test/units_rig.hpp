// SPDX-License-Identifier: Apache-2.0
// For tests: numbers that many of them use.
#pragma once

#include <cstdint>
#include <limits>
#include <numbers>

namespace lithe {

inline constexpr std::int64_t kMs = 1'000'000;         // [ns]
inline constexpr double kTurn = 2 * std::numbers::pi;  // [rad]
inline constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

}  // namespace lithe
