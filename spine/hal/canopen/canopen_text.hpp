// SPDX-License-Identifier: Apache-2.0
// Text for the numbers and the frames of CANopen, and its nodes for `lithe bus scan` and `lithe bus monitor`.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string_view>
#include <utility>

#include "spine/core/rt.hpp"
#include "spine/hal/canopen/canopen.hpp"
#include "spine/hal/core/bus_tools.hpp"

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

// Sends what `next` gives, and hands `take` the answers of this node, until `over`.
// Contract: as hal::Scanner::ask
void converse(const AskedBus& line, std::uint32_t node, const std::function<bool(std::int64_t now_ns, Frame&)>& next,
              const std::function<bool(const Frame&)>& take, const std::function<bool()>& over);
// Asks every id for object 1000h, then those that answered for their identity. Up to 4 s on a slow bus.
std::unique_ptr<Scanner> make_scanner();
// Any bytes are safe.
FrameText frame_text(const Frame& frame, const FrameContext& context);

}  // namespace lithe::hal::canopen
