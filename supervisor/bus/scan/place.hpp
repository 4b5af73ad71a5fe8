// SPDX-License-Identifier: Apache-2.0
// Selects buses: all of a robot file, one of them, or one given as KIND:PLACE.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "spine/core/result.hpp"
#include "spine/robot/config.hpp"

namespace lithe::bus {

// The arguments of the command line.
struct Words {
  std::string what;   // a robot file, or a bus as bus_forms() says
  std::string bus{};  // of the file, by name; empty = all
  // Bit rates of a bus given as KIND:PLACE; default: those of a robot file without these keys.
  std::optional<std::uint32_t> bitrate{};
  std::optional<std::uint32_t> data_bitrate{};
};

struct Choice {
  robot::RobotConfig robot;        // without a file: one bus and nothing else
  bool from_file = false;          // the expected devices are known
  std::vector<std::size_t> buses;  // indices into robot.buses; at least one
};

// The error says what is wrong and what is expected.
// Contract: not RT · reads the robot file, opens no bus
Result<Choice> choose(const Words& words);

// The forms of KIND:PLACE for all kinds of real buses, a space between two.
std::string bus_forms();

// The protocol of the file's devices on this bus. Without a file: that of the first kind of device that needs such a
// bus, with CAN FD or without.
robot::Protocol protocol_of(const robot::RobotConfig& robot, std::size_t bus);

// "KIND:PLACE"; "loop" for one in memory.
std::string place_of(const robot::BusConfig& bus);

// True when both are the same hardware, also under two names; two loop buses are never the same.
bool same_hardware(const robot::BusConfig& a, const robot::BusConfig& b);

}  // namespace lithe::bus
