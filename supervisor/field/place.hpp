// SPDX-License-Identifier: Apache-2.0
// Which buses somebody means: those of a robot file, one of them, or one given as KIND:PLACE.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "spine/core/result.hpp"
#include "spine/robot/config.hpp"

namespace lithe::field {

// As they stand on the command line.
struct Words {
  std::string what;   // a robot file, or "socketcan:can0", "fdcanusb:/dev/ttyACM0", "slcan:/dev/ttyACM1", "pi3hat:1"
  std::string bus{};  // of the file, by name; empty = all
  // Of a bus that is given as KIND:PLACE; without them those of a robot file that says nothing.
  std::optional<std::uint32_t> bitrate{};
  std::optional<std::uint32_t> data_bitrate{};
};

struct Choice {
  robot::RobotConfig robot;        // its one bus and nothing else when there is no file
  bool from_file = false;          // what is expected is known
  std::vector<std::size_t> buses;  // indices into robot.buses; at least one
};

// The error says what is wrong and what would be right.
// Contract: not RT · reads the robot file, opens no bus
Result<Choice> choose(const Words& words);

// "fdcanusb:/dev/ttyACM0"; "loop" for one in memory.
std::string place_of(const robot::BusConfig& bus);

// One piece of hardware under two names counts as one; buses in memory are never the same.
bool same_hardware(const robot::BusConfig& a, const robot::BusConfig& b);

}  // namespace lithe::field
