// SPDX-License-Identifier: Apache-2.0
// A gateway in a robot file: what the registry's row needs of it.
#pragma once

#include <memory>

#include "spine/hal/core/planned_frame.hpp"
#include "spine/hal/core/sensors.hpp"
#include "spine/robot/config.hpp"

namespace lithe::hal::gateway {

std::unique_ptr<SensorDevice> make_gateway(const robot::DeviceConfig& device);
// It sends at the rate of the sketch in firmware/, one block after the other.
PlannedFrames planned_frames(const robot::DeviceConfig& device, const robot::BusConfig& bus);

}  // namespace lithe::hal::gateway
