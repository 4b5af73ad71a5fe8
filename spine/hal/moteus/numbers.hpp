// SPDX-License-Identifier: Apache-2.0
// Numbers as text for a drive's console, without the heap and without the locale.
#pragma once

#include <cstddef>
#include <span>
#include <string_view>

#include "spine/core/rt.hpp"

namespace lithe::hal {

// Parses the whole text as a decimal number: sign, digits, point, exponent; or nan, inf. False: not a number.
// Contract: RT · pure
bool read_number(std::string_view text, double& value) LITHE_RT;

inline constexpr std::size_t kLongestNumber = 40;

// Formats without a point when `integer`, else with six digits after it; clamped to 1e15. The length, at most
// kLongestNumber; 0 when it does not fit.
std::size_t write_number(double value, bool integer, std::span<char> out) LITHE_RT;

}  // namespace lithe::hal
