// SPDX-License-Identifier: Apache-2.0
// Advice for a robot whose buses are too busy.
#pragma once

#include <string>
#include <vector>

#include "spine/robot/config.hpp"
#include "supervisor/bus/plan/plan.hpp"

namespace lithe::bus {

// Sentences, the most useful first: devices to move to another bus, rate dividers, a lower rate. Every change is
// planned again before it is proposed, so the changed robot fits and its file can be loaded. Empty when the robot fits
// and waits for its answers.
// Contract: pure · never in the tick
std::vector<std::string> advise(const robot::RobotConfig& robot, const PlanOptions& options);

// What `lithe run` does with a robot: start, warn or refuse.
struct Verdict {
  bool refuse = false;
  std::string text;  // one sentence with the numbers; empty = no finding
  std::string next;  // what to do
};

// Refuses when a real bus, or the serial line to its adapter, needs more than 100 % of its time with frames of average
// length. Warns when a bus has no room to repeat a frame, when an exchange may be longer than a tick, and when answers
// are not waited for. A loop bus is never refused: it takes no time.
Verdict judge_for_run(const robot::RobotConfig& robot);

}  // namespace lithe::bus
