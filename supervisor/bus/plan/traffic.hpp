// SPDX-License-Identifier: Apache-2.0
// The frames that a device causes on its bus, and what each of them costs there.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "spine/robot/config.hpp"

namespace lithe::bus {

// Frames of one kind. Average: with their real identifiers, over payloads as random as those of a moving robot.
// Worst: no frame of this shape is longer.
struct Traffic {
  std::string what;  // "command", "answer", "SYNC" ...
  std::size_t size = 0;
  bool extended = false;
  bool fd = false;
  bool outbound = false;      // from the robot's computer to a device
  bool unasked = false;       // sent by the device's own clock
  double per_tick = 0;        // frames, with the device's rate divider
  double per_s = 0;           // those that go by the clock instead
  double average_us = 0;      // each, on the bus
  double worst_us = 0;        //
  double text_out_bytes = 0;  // each, on the line to a serial adapter, and back
  double text_in_bytes = 0;   //
  double spi_us = 0;          // each, between the computer and a board's processor
};

enum class Detail { all, worst_only };  // averages take a hundred times as long as all the rest

// The frames of one device, as its row in the registry tells them.
// Contract: pure · never in the tick
std::vector<Traffic> traffic_of(const robot::DeviceConfig& device, const robot::BusConfig& bus, Detail detail);

// The frames that a bus needs in addition, for example SYNC and our heartbeat. Empty for most.
std::vector<Traffic> shared_traffic(const robot::RobotConfig& robot, std::size_t bus, Detail detail);

}  // namespace lithe::bus
