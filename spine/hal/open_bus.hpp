// SPDX-License-Identifier: Apache-2.0
// From a robot file's words to a bus that can be used.
#pragma once

#include <memory>
#include <vector>

#include "spine/core/result.hpp"
#include "spine/hal/bus/bus.hpp"
#include "spine/hal/bus/pi3hat_bus.hpp"
#include "spine/robot/config.hpp"

namespace lithe::hal {

// Opens the hardware behind any kind but `loop`. The error says what is missing and what to do. Contract: never in the
// tick
Result<std::unique_ptr<Bus>> open_bus(const robot::BusConfig& config);

// The board behind all buses of kind pi3hat of a robot, to be used through a Pi3hatBus for each. A connector without a
// bus stays silent. `port`: whatever stands in for the hardware; null = the board of this machine. Contract: as
// open_bus
Result<std::shared_ptr<Pi3hatBoard>> open_pi3hat(const std::vector<robot::BusConfig>& buses, bool polled,
                                                 std::unique_ptr<Pi3hatPort> port = nullptr);

}  // namespace lithe::hal
