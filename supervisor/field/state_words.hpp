// SPDX-License-Identifier: Apache-2.0
// What devices say in numbers, in words.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "spine/hal/device/canopen.hpp"

namespace lithe::field {

std::string_view word(hal::canopen::NmtState state);
std::string_view word(hal::canopen::NmtCommand command);

// What an emergency is about, by the code's class where the code itself is not known; never empty.
std::string_view emergency_name(std::uint16_t code);

// Bytes that a device calls text: what no terminal should be sent becomes a question mark.
std::string printable(std::string_view bytes);

}  // namespace lithe::field
