// SPDX-License-Identifier: Apache-2.0
// Checks a plan. The Brain's bytes are hostile until this check has passed.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "spine/core/joints.hpp"
#include "spine/core/rt.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::plan {

inline constexpr std::int64_t kHorizonNs = 10'000'000'000;  // no waypoint further away than this, before or behind

// Of one joint's setpoint.
struct JointLimits {
  double position_min_rad = 0, position_max_rad = 0, velocity_max_rad_s = 0;
};
struct Limits {
  std::array<JointLimits, kMaxJoints> joint{};
  std::size_t joints = 0;
};

// Replaces a plan's values for a stopped joint by rest at `position_rad`. Else they could get the plan refused for the
// other joints as well.
// Contract: RT · any bytes of a plan are safe
void rest_joint(wire::Plan& plan, std::size_t joint, double position_rad) LITHE_RT;

// The first reason not to follow `plan`, or none. Waypoints in the past are fine as long as one is in the future. A
// waypoint outside the position limits, a given velocity above the limit, or two waypoints that no motion within the
// velocity limit connects are refused, not corrected: otherwise the Brain would assume a motion that does not happen.
// Contract: RT · pure · looks only at the waypoints and joints in use
wire::PlanReject check(const wire::Plan& plan, const Limits& limits, std::int64_t now_ns) LITHE_RT;

}  // namespace lithe::plan
