// SPDX-License-Identifier: Apache-2.0
// Text for one CAN frame, on a bus of a robot file.
#pragma once

#include <cstddef>

#include "spine/hal/core/bus_tools.hpp"
#include "spine/robot/config.hpp"

namespace lithe::bus {

// Decoded by the protocol of the bus; frames of a kind of its own (a gateway) are recognised on every bus. Process
// data is decoded by LITHE's own PDO mapping; for a node that is not in the file it is shown as bytes.
// Contract: any frame is safe
hal::FrameText decode(const hal::Frame& frame, robot::Protocol protocol, const robot::RobotConfig& robot,
                      std::size_t bus);

}  // namespace lithe::bus
