// SPDX-License-Identifier: Apache-2.0
// Makes a plan from the arguments of `lithe move` and `lithe jog`, or refuses them.
#pragma once

#include <cstddef>
#include <cstdint>
#include <numbers>
#include <variant>

#include "spine/wire/wire.hpp"
#include "supervisor/cli/core/act.hpp"
#include "supervisor/core/answer.hpp"

namespace lithe::cli {

inline constexpr double kDegPerRad = 180.0 / std::numbers::pi;

struct Move {
  wire::Plan plan;
  std::size_t joint = 0;
  double from_rad = 0, to_rad = 0;  // of the setpoint
  double at_rad = 0;                // where the joint is at the start
};

// Whether the joint is at its target, or went the way of its setpoint: within a tenth of that way, at least 1 deg.
// Contract: pure
bool has_arrived(const Move& move, double position_rad);

// Says where the joint is, where it should be, and what its drive is asked for.
control::Refusal not_arrived(const Move& move, const wire::RobotInfo& info, const wire::Telemetry& now);

// A plan of one waypoint: the joint at its target, all others at their setpoints. Refuses, with joint, value and limit:
// a mode other than active, an unknown joint, an angle beyond its limits, a time outside 0.1 to 10 s, a speed beyond
// its limit (the curve's fastest is 1.5 times its mean).
// Contract: pure
std::variant<Move, control::Refusal> plan_motion(const Motion& motion, const wire::RobotInfo& info,
                                                 const wire::Telemetry& now, std::int64_t now_ns);

}  // namespace lithe::cli
