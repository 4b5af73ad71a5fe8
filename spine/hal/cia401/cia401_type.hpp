// SPDX-License-Identifier: Apache-2.0
// A CiA 401 module in a robot file: what the registry's row needs of it.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <string_view>

#include "spine/hal/canopen/canopen_pdo.hpp"
#include "spine/hal/core/planned_frame.hpp"
#include "spine/hal/core/sensors.hpp"
#include "spine/robot/config.hpp"

namespace lithe::hal::cia401 {

std::unique_ptr<SensorDevice> make_module(const robot::DeviceConfig& device);
PlannedFrames planned_frames(const robot::DeviceConfig& device, const robot::BusConfig& bus);

bool process_map(const robot::DeviceConfig& device, std::uint32_t id, canopen::PdoMap& map);
std::string process_value(const canopen::Mapped& mapped, std::uint32_t raw);
std::string_view object_name(std::uint16_t index);

}  // namespace lithe::hal::cia401
