// SPDX-License-Identifier: Apache-2.0
// From a robot file's words to the simulated devices at the far end of its buses.
#pragma once

#include <cstddef>
#include <memory>

#include "spine/hal/bus/loop_bus.hpp"
#include "spine/robot/config.hpp"

namespace lithe::hal::sim {

// The device with this index, with the plant of the joint that it moves; a drive that moves none turns freely.
// Contract: never in the tick
std::unique_ptr<BusNode> make_node(const robot::RobotConfig& config, std::size_t device);

}  // namespace lithe::hal::sim
