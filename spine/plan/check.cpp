// SPDX-License-Identifier: Apache-2.0
#include "spine/plan/check.hpp"

#include <cmath>
#include <limits>

namespace lithe::plan {
namespace {

using wire::PlanReject;

constexpr double kRounding = 1.0e-9;

double seconds_between(std::int64_t from_ns, std::int64_t to_ns) LITHE_RT {  // of any two numbers
  return (static_cast<double>(to_ns) - static_cast<double>(from_ns)) * 1e-9;
}

wire::PlanDecision time_refused(PlanReject reason, std::size_t w, double value_s, double limit_s) LITHE_RT {
  wire::PlanDecision out = decision(reason, value_s, limit_s);
  out.waypoint = static_cast<std::uint32_t>(w);
  return out;
}

wire::PlanDecision check_times(const wire::Plan& plan, std::int64_t stale_ns, std::int64_t now_ns) LITHE_RT {
  constexpr double kHorizonS = static_cast<double>(kHorizonNs) * 1e-9;
  const std::size_t last = plan.waypoint_count - 1;
  for (std::size_t w = 0; w < last; ++w)
    if (plan.t_ns[w + 1] <= plan.t_ns[w])
      return time_refused(PlanReject::time_order, w + 1, seconds_between(plan.t_ns[w], plan.t_ns[w + 1]), 0);
  if (plan.t_ns[last] <= now_ns - stale_ns)
    return time_refused(PlanReject::too_old, last, seconds_between(now_ns, plan.t_ns[last]),
                        seconds_between(stale_ns, 0));
  if (plan.t_ns[0] < now_ns - kHorizonNs)
    return time_refused(PlanReject::too_old, 0, seconds_between(now_ns, plan.t_ns[0]), -kHorizonS);
  if (plan.t_ns[last] > now_ns + kHorizonNs)
    return time_refused(PlanReject::too_far, last, seconds_between(now_ns, plan.t_ns[last]), kHorizonS);
  return decision(PlanReject::none);
}

bool within_limits(const wire::Plan& plan, const Limits& limits) LITHE_RT {
  bool inside = true;
  const double any_way = is_held(plan) ? std::numeric_limits<double>::infinity() : kRounding;
  for (std::size_t w = 0; w < plan.waypoint_count; ++w) {
    const double* position = &plan.position_rad[w * wire::kNj];
    const double* velocity = &plan.velocity_rad_s[w * wire::kNj];
    const double* before = w > 0 ? position - wire::kNj : position;
    const double gap_s = w > 0 ? static_cast<double>(plan.t_ns[w] - plan.t_ns[w - 1]) * 1e-9 : 0.0;
    for (std::size_t j = 0; j < limits.joints; ++j) {
      const double fastest = limits.joint[j].velocity_max_rad_s * (1 + kRounding);
      inside &= position[j] >= limits.joint[j].position_min_rad - kRounding &&
                position[j] <= limits.joint[j].position_max_rad + kRounding;
      inside &= !(std::abs(velocity[j]) > fastest);
      inside &= std::abs(position[j] - before[j]) <= fastest * gap_s + any_way;
    }
  }
  return inside;
}

// The first value that is not within the limits, of a plan that has one.
wire::PlanDecision find_culprit(const wire::Plan& plan, const Limits& limits) LITHE_RT {
  const auto each = [&](auto look) LITHE_RT {
    for (std::size_t w = 0; w < plan.waypoint_count; ++w) {
      for (std::size_t j = 0; j < limits.joints; ++j) {
        wire::PlanDecision found =
            look(w, limits.joint[j], &plan.position_rad[w * wire::kNj + j], plan.velocity_rad_s[w * wire::kNj + j]);
        if (reason_of(found) == PlanReject::none) continue;
        found.waypoint = static_cast<std::uint32_t>(w);
        found.joint = static_cast<std::uint32_t>(j);
        return found;
      }
    }
    return decision(PlanReject::none);
  };
  const auto not_finite = [](std::size_t, const JointLimits&, const double* rad, double rad_s) LITHE_RT {
    const bool bad = !std::isfinite(*rad) || std::isinf(rad_s);
    return decision(bad ? PlanReject::not_finite : PlanReject::none, std::isfinite(*rad) ? rad_s : *rad);
  };
  const auto outside = [](std::size_t, const JointLimits& limit, const double* rad, double) LITHE_RT {
    if (*rad < limit.position_min_rad - kRounding)
      return decision(PlanReject::position_limit, *rad, limit.position_min_rad);
    if (*rad > limit.position_max_rad + kRounding)
      return decision(PlanReject::position_limit, *rad, limit.position_max_rad);
    return decision(PlanReject::none);
  };
  const auto too_fast = [&](std::size_t w, const JointLimits& limit, const double* rad, double rad_s) LITHE_RT {
    const double most_rad_s = limit.velocity_max_rad_s;
    if (std::abs(rad_s) > most_rad_s * (1 + kRounding))
      return decision(PlanReject::velocity_limit, std::abs(rad_s), most_rad_s);
    return w == 0 || is_held(plan) ? decision(PlanReject::none)
                                   : check_way(*rad - *(rad - wire::kNj), plan.t_ns[w] - plan.t_ns[w - 1], most_rad_s);
  };
  wire::PlanDecision found = each(not_finite);
  if (reason_of(found) == PlanReject::none) found = each(outside);
  return reason_of(found) == PlanReject::none ? each(too_fast) : found;
}

}  // namespace

void rest_joint(wire::Plan& plan, std::size_t joint, double position_rad) LITHE_RT {
  for (std::size_t at = joint; at < wire::kNw * wire::kNj; at += wire::kNj) {
    plan.position_rad[at] = position_rad;
    plan.velocity_rad_s[at] = 0;
  }
}

wire::PlanDecision check_way(double way_rad, std::int64_t lasts_ns, double most_rad_s) LITHE_RT {
  const double way = std::abs(way_rad), lasts_s = static_cast<double>(lasts_ns) * 1e-9;
  if (way <= most_rad_s * (1 + kRounding) * lasts_s + kRounding) return decision(PlanReject::none);
  wire::PlanDecision out = decision(PlanReject::velocity_limit, way / lasts_s, most_rad_s);
  out.way_rad = way_rad;
  out.needs_s = kRestToRest * way / most_rad_s;
  return out;
}

wire::PlanDecision check(const wire::Plan& plan, const Limits& limits, std::int64_t now_ns) LITHE_RT {
  if (plan.waypoint_count < 1 || plan.waypoint_count > wire::kNw)
    return decision(PlanReject::count, plan.waypoint_count, static_cast<double>(wire::kNw));
  if (plan.joint_count != limits.joints)
    return decision(PlanReject::joints, plan.joint_count, static_cast<double>(limits.joints));
  const wire::PlanDecision times = check_times(plan, is_held(plan) ? limits.stale_ns : 0, now_ns);
  if (reason_of(times) != PlanReject::none) return times;
  // NaN and infinity fail the limits too, so a valid plan is read once; only an invalid one is examined for the reason.
  return within_limits(plan, limits) ? decision(PlanReject::none) : find_culprit(plan, limits);
}

}  // namespace lithe::plan
