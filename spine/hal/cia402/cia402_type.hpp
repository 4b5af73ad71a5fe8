// SPDX-License-Identifier: Apache-2.0
// A CiA 402 drive in a robot file: what the registry's row needs of it.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <string_view>

#include "spine/hal/canopen/canopen_pdo.hpp"
#include "spine/hal/core/drive.hpp"
#include "spine/hal/core/planned_frame.hpp"
#include "spine/robot/config.hpp"

namespace lithe::hal::cia402 {

std::unique_ptr<Drive> make_drive(const robot::RobotConfig& robot, const robot::JointConfig& joint);
// SYNC and our heartbeat, for all drives of the bus.
std::unique_ptr<BusMaster> make_master(const robot::RobotConfig& robot, std::size_t bus);
// One SYNC asks all drives of the bus, and each answers every SYNC.
PlannedFrames planned_frames(const robot::DeviceConfig& device, const robot::BusConfig& bus);
PlannedFrames bus_frames(const robot::RobotConfig& robot, std::size_t bus);

// For example "fault: too hot (42xxh)".
std::string state_words(std::uint32_t state, std::uint32_t error_class);
bool process_map(const robot::DeviceConfig& device, std::uint32_t id, canopen::PdoMap& map);
std::string process_value(const canopen::Mapped& mapped, std::uint32_t raw);
std::string_view object_name(std::uint16_t index);

}  // namespace lithe::hal::cia402
