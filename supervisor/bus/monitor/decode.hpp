// SPDX-License-Identifier: Apache-2.0
// One frame in words.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>

#include "spine/hal/core/frame.hpp"
#include "spine/robot/config.hpp"
#include "supervisor/bus/scan/seen.hpp"

namespace lithe::field {

struct Decoded {
  bool outbound = false;  // to a device, by what it says; whoever has seen where it came from knows better
  std::optional<std::uint32_t> device;  // whose frame it is, or for whom; none: for all, or nobody can tell
  std::string text;                     // never empty, printable
};

// Contract: pure · any frame whatever, also what no device says
Decoded decode_moteus(const hal::Frame& frame);
// Process data is taken apart as LITHE has its drives map it; of a node that is no drive of the file it stays bytes.
Decoded decode_canopen(const hal::Frame& frame, const robot::RobotConfig& robot, std::size_t bus);
Decoded decode_gateway(const hal::Frame& frame);

// By the protocol of the bus; a gateway's frames are known on every bus.
Decoded decode(const hal::Frame& frame, Protocol protocol, const robot::RobotConfig& robot, std::size_t bus);

}  // namespace lithe::field
