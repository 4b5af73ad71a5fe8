// SPDX-License-Identifier: Apache-2.0
// Robots by their shared memory, with or without a supervisor.
#pragma once

#include <cstddef>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "spine/core/result.hpp"
#include "spine/robot/config.hpp"
#include "supervisor/field/monitor.hpp"
#include "supervisor/field/place.hpp"

namespace lithe::cli {

// A Spine at work on a bus that somebody has chosen.
struct Occupied {
  std::string robot;
  robot::RobotConfig config;  // what it was started with
  std::size_t theirs = 0;     // the bus, as it counts them
  std::size_t ours = 0;       // and as they were chosen
  std::string words() const;  // "robot 'arm' (bus 'can0')"
};

// Every such bus. A bus in memory is that of the robot file it stands in, and of no other. `warn` gets a sentence for
// each robot that runs, or may run, and whose buses nobody can tell: it belongs to another user, or its file is no
// longer what it was started with.
// Contract: not RT · reads the robot files of all that run
std::vector<Occupied> spines_on(const field::Choice& choice, const std::function<void(const std::string&)>& warn);

// The frames of that bus, as its Spine shows them to whoever asks; it is asked as long as this lives, and that of the
// next Spine of this robot when there is another. They are told as those of bus `ours`.
// Contract: as field::FrameSource
Result<std::unique_ptr<field::FrameSource>> watch_spine(const Occupied& bus);

}  // namespace lithe::cli
