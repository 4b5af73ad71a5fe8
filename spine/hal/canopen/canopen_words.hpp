// SPDX-License-Identifier: Apache-2.0
// Text for the numbers of CANopen.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

#include "spine/hal/canopen/canopen.hpp"

namespace lithe::hal::canopen {

// Text for an emergency code; for an unknown code the text of its class. Never empty.
std::string_view emergency_name(std::uint16_t code);

std::string_view word(NmtState state);
std::string_view word(NmtCommand command);

// With at least that many digits.
std::string hex(std::uint32_t value, std::size_t digits);

}  // namespace lithe::hal::canopen
