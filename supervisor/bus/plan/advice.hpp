// SPDX-License-Identifier: Apache-2.0
// What to change on a robot whose buses cannot carry what they must.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "spine/robot/config.hpp"
#include "supervisor/bus/plan/plan.hpp"

namespace lithe::bus {

// Sentences, in the order in which they help: devices that move to a bus with room, rate dividers, a lower rate.
// Everything that is said is planned again first: who follows it has a robot that fits and can be loaded. Empty for one
// that fits and waits for its answers.
// Contract: pure · never in the tick
std::vector<std::string> advise(const robot::RobotConfig& robot, const PlanOptions& options);

// What `lithe run` makes of a robot.
struct Verdict {
  bool refuse = false;
  std::string text;  // one sentence with the numbers; empty: nothing to say
  std::string next;  // what to do
};

// Refuses where a real bus, or the line to its adapter, is asked for more than all its time, with frames of average
// length; warns where one is too busy to repeat a frame, where an exchange may be longer than a tick, and where answers
// are not waited for. A loop bus has no time to run out of.
Verdict judge_for_run(const robot::RobotConfig& robot);

}  // namespace lithe::bus
