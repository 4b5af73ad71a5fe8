// SPDX-License-Identifier: Apache-2.0
// Text for one CAN frame.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>

#include "spine/hal/core/frame.hpp"
#include "spine/robot/config.hpp"
#include "supervisor/bus/scan/observation.hpp"

namespace lithe::bus {

struct Decoded {
  bool outbound = false;  // towards a device, guessed from the content; used when the true direction is unknown
  std::optional<std::uint32_t> device;  // id of the sender or receiver; empty = broadcast, or unknown
  std::string text;                     // never empty, printable
};

// Contract: pure · any frame is safe
Decoded decode_moteus(const hal::Frame& frame);
// Process data is decoded by LITHE's own PDO mapping. For a node that is not a drive of the file it is shown as bytes.
Decoded decode_canopen(const hal::Frame& frame, const robot::RobotConfig& robot, std::size_t bus);
Decoded decode_gateway(const hal::Frame& frame);

// Decoded by the protocol of the bus; frames of gateways are recognised on every bus.
Decoded decode(const hal::Frame& frame, Protocol protocol, const robot::RobotConfig& robot, std::size_t bus);

}  // namespace lithe::bus
