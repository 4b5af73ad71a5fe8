// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/core/bus_tools.hpp"

#include <fmt/format.h>

namespace lithe::hal {

std::string bytes_text(const Frame& frame) {
  std::string text;
  for (const std::uint8_t byte : frame.payload()) text += fmt::format("{}{:02x}", text.empty() ? "" : " ", byte);
  return text.empty() ? "no data" : text;
}

}  // namespace lithe::hal
