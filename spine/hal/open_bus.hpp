// SPDX-License-Identifier: Apache-2.0
// From a robot file's words to a bus that can be used.
#pragma once

#include <memory>

#include "spine/core/result.hpp"
#include "spine/hal/bus/bus.hpp"
#include "spine/robot/config.hpp"

namespace lithe::hal {

// Opens the hardware behind any kind but `loop`. The error says what is missing and what to do. Contract: never in the
// tick
Result<std::unique_ptr<Bus>> open_bus(const robot::BusConfig& config);

}  // namespace lithe::hal
