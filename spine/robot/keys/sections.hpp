// SPDX-License-Identifier: Apache-2.0
// Each section of robot.toml: its keys, their ranges and where they go. A new key is one line here, one in config.hpp.
#pragma once

#include <string_view>
#include <vector>

#include "spine/robot/config.hpp"
#include "spine/robot/read/reader.hpp"

namespace lithe::robot {

void read_spine(Reader& in, SpineConfig& spine);
void read_guard(Reader& in, GuardConfig& guard);
void read_brain(Reader& in, BrainConfig& brain);
void read_swap(Reader& in, SwapConfig& swap);
void read_bus(Reader& in, BusConfig& bus, double rate_hz);
void read_sensor(Reader& in, SensorConfig& sensor, const std::vector<std::string_view>& devices);

// The keys that [defaults] may contain; there `need` is optional. Name, id and device cannot have a default.
void read_device(Reader& in, DeviceConfig& device, const std::vector<std::string_view>& buses, Need need);
void read_joint(Reader& in, JointConfig& joint, Need need);

}  // namespace lithe::robot
