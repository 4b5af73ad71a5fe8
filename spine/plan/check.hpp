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
  std::int64_t stale_ns = 0;  // a held waypoint that is older holds on, but counts as stale
};

inline bool is_held(const wire::Plan& plan) LITHE_RT {
  return plan.interpolation == static_cast<std::uint32_t>(wire::Interpolation::hold);
}

// Replaces a plan's values for a stopped joint by rest at `position_rad`. Else they could get the plan refused for the
// other joints as well.
// Contract: RT · any bytes of a plan are safe
void rest_joint(wire::Plan& plan, std::size_t joint, double position_rad) LITHE_RT;

// What is decided about a plan: the reason to refuse it, or none, with the value and the limit. It is about no joint
// and the first waypoint until these are set.
// Contract: RT · a value; plan_id, t_ns and text are left to the caller
inline wire::PlanDecision decision(wire::PlanReject reason, double value = 0, double limit = 0) LITHE_RT {
  wire::PlanDecision out;
  out.reject = static_cast<std::uint32_t>(reason);
  out.joint = wire::kNj;
  out.value = value;
  out.limit = limit;
  return out;
}
inline wire::PlanReject reason_of(const wire::PlanDecision& decision) LITHE_RT {
  return static_cast<wire::PlanReject>(decision.reject);
}

inline constexpr double kRestToRest = 1.5;  // highest speed of a cubic from rest to rest, by its mean

// Refused when no motion below `most_rad_s` covers this way of a joint in this time. needs_s is then the time of a
// cubic from rest to rest that does.
// Contract: RT · pure · lasts_ns > 0
wire::PlanDecision check_way(double way_rad, std::int64_t lasts_ns, double most_rad_s) LITHE_RT;

// The first reason not to follow `plan`, or none. Waypoints in the past are fine as long as one is in the future. A
// waypoint outside the position limits, a given velocity above the limit, or two waypoints that no motion within the
// velocity limit connects are refused, not corrected: otherwise the Brain would assume a motion that does not happen.
// The waypoints of a held plan may be any way apart, and all of them in the past, the last by less than stale_ns.
// Contract: RT · pure · looks only at the waypoints and joints in use
wire::PlanDecision check(const wire::Plan& plan, const Limits& limits, std::int64_t now_ns) LITHE_RT;

}  // namespace lithe::plan
