// SPDX-License-Identifier: Apache-2.0
// The context of all trials of one robot, and one trial request.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "spine/core/time.hpp"
#include "spine/hal/actuators.hpp"
#include "spine/load/law_store.hpp"
#include "spine/robot/config.hpp"
#include "spine/wire/wire.hpp"
#include "trial/core/report.hpp"

namespace lithe::trial {

// A simulated robot, at rest, with its drives on.
struct SimulatedRobot {
  std::unique_ptr<hal::Actuators> actuators;
  std::int64_t from_ns = 0;     // on the clock of that robot
  std::uint32_t run_ticks = 0;  // that a run lasts: a second, or less of a robot that takes long to simulate
  LoopStats baseline;           // of a run without a law
};

// Contract: made by the zygote before the first trial; a child has its own copy, by fork
struct TrialSetup {
  robot::RobotConfig robot;
  SimulatedRobot plain, heavy;  // as the robot file says; with a payload, for the rough run
  SimulatedRobot carried;       // as plain, for the run with the State that will be carried
  RawClock clock;
  int run_ms = 0;  // of the processor, which the three runs take without a law; a law's take it again
  std::unique_ptr<load::ArenaStore> arena;  // null = there is none
  bool filtered = false;                    // allow_trials_only() holds for the zygote, and so for its children

  std::uint32_t joints() const { return static_cast<std::uint32_t>(robot.joints.size()); }
  std::int64_t period_ns() const { return static_cast<std::int64_t>(1e9 / robot.rate_hz); }
  double dt_s() const { return 1 / robot.rate_hz; }
};

// One request, checked.
struct TrialRequest {
  wire::StageRequest stage;  // where the code is: `path`, or slot, code_bytes, entry and image_hash
  std::int64_t budget_ns = 0;
  int box_ms = 150;
  std::string recording;                               // the robot whose telemetry is replayed; empty = none
  std::vector<std::pair<std::string, double>> params;  // instead of the compiled values
};

}  // namespace lithe::trial
