// SPDX-License-Identifier: Apache-2.0
// Text for the numbers of CANopen.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>
#include <utility>

#include "spine/core/rt.hpp"
#include "spine/hal/canopen/canopen.hpp"

namespace lithe::hal::canopen {

// A row for each code that has a name.
using Names = std::pair<std::uint32_t, std::string_view>;

// The name of a code; `otherwise` where there is none.
template <std::size_t N>
std::string_view name_in(const Names (&names)[N], std::uint32_t code, std::string_view otherwise = {}) LITHE_RT {
  for (const auto& [each, name] : names)
    if (each == code) return name;
  return otherwise;
}

// Text for an emergency code; for an unknown code the text of its class. Never empty.
std::string_view emergency_name(std::uint16_t code);

std::string_view word(NmtState state);
std::string_view word(NmtCommand command);

// With at least that many digits.
std::string hex(std::uint32_t value, std::size_t digits);

}  // namespace lithe::hal::canopen
