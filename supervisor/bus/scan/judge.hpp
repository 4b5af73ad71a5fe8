// SPDX-License-Identifier: Apache-2.0
// Compares the devices found on a bus with the robot file.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "spine/robot/config.hpp"
#include "supervisor/bus/scan/scan.hpp"

namespace lithe::bus {

enum class Standing : std::uint8_t {
  expected,  // in the file and on the bus
  present,   // on a bus of which no file says anything
  unknown,   // on the bus, not in the file
  missing,   // in the file, not on the bus
  twice,     // several devices answer to this id
  unfit,     // there, but cannot be driven by LITHE
};
std::string_view word(Standing standing);

struct Judged {
  robot::DeviceKind kind = robot::DeviceKind::moteus;
  std::uint32_t id = 0;
  std::string name;  // in the file; empty where it has none
  Standing standing = Standing::present;
  std::string what;    // the device's own description, as text
  std::string advice;  // what to do next; empty = nothing
};

struct BusFindings {
  std::size_t bus = 0;  // index into the robot's buses
  std::vector<Judged> devices;
  std::string error;  // why the scan is incomplete; empty = complete
  std::string note;   // a remark that is not an error
};

// Contract: pure
BusFindings judge(const robot::RobotConfig& robot, std::size_t bus, bool from_file, const Line& line);

// True when the bus is as the file says.
bool matches(const BusFindings& findings);

}  // namespace lithe::bus
