// SPDX-License-Identifier: Apache-2.0
// Text for the numbers that devices report.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "spine/hal/canopen/canopen.hpp"

namespace lithe::field {

std::string_view word(hal::canopen::NmtState state);
std::string_view word(hal::canopen::NmtCommand command);

}  // namespace lithe::field
