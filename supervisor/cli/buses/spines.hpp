// SPDX-License-Identifier: Apache-2.0
// Finds running Spines by their shared memory, with or without a supervisor.
#pragma once

#include <cstddef>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "spine/core/result.hpp"
#include "spine/robot/config.hpp"
#include "supervisor/bus/monitor/monitor.hpp"
#include "supervisor/bus/scan/place.hpp"

namespace lithe::cli {

// A chosen bus that a running Spine uses.
struct Occupied {
  std::string robot;
  robot::RobotConfig config;  // what it was started with
  std::size_t theirs = 0;     // index of the bus in the Spine
  std::size_t ours = 0;       // index in the chosen robot file
  std::string words() const;  // "robot 'arm' (bus 'can0')"
};

// All such buses. A loop bus belongs to its own robot file only. `warn` gets a sentence for each robot whose buses
// cannot be known: it belongs to another user, or its file has changed since the start.
// Contract: not RT · reads the robot files of all that run
std::vector<Occupied> spines_on(const bus::Choice& choice, const std::function<void(const std::string&)>& warn);

// The frames of that bus, copied by its Spine while this object exists, and by the next Spine of the robot after a
// restart. They are reported as frames of bus `ours`.
// Contract: as bus::FrameSource
Result<std::unique_ptr<bus::FrameSource>> watch_spine(const Occupied& bus);

}  // namespace lithe::cli
