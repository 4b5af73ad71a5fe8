// SPDX-License-Identifier: Apache-2.0
#include "spine/plan/check.hpp"

#include <cmath>

namespace lithe::plan {
namespace {

using wire::PlanReject;

constexpr double kRounding = 1.0e-9;

PlanReject check_times(const wire::Plan& plan, std::int64_t now_ns) LITHE_RT {
  const std::size_t last = plan.waypoint_count - 1;
  for (std::size_t w = 0; w < last; ++w)
    if (plan.t_ns[w + 1] <= plan.t_ns[w]) return PlanReject::time_order;
  if (plan.t_ns[last] <= now_ns || plan.t_ns[0] < now_ns - kHorizonNs) return PlanReject::too_old;
  return plan.t_ns[last] > now_ns + kHorizonNs ? PlanReject::too_far : PlanReject::none;
}

PlanReject check_finite(const wire::Plan& plan, std::size_t joints) LITHE_RT {
  bool finite = true;
  for (std::size_t w = 0; w < plan.waypoint_count; ++w) {
    const double* position = &plan.position_rad[w * wire::kNj];
    const double* velocity = &plan.velocity_rad_s[w * wire::kNj];
    for (std::size_t j = 0; j < joints; ++j) finite &= std::isfinite(position[j]) && !std::isinf(velocity[j]);
  }
  return finite ? PlanReject::none : PlanReject::not_finite;
}

PlanReject check_limits(const wire::Plan& plan, const Limits& limits) LITHE_RT {
  bool inside = true;
  bool slow_enough = true;
  for (std::size_t w = 0; w < plan.waypoint_count; ++w) {
    const double* position = &plan.position_rad[w * wire::kNj];
    const double* velocity = &plan.velocity_rad_s[w * wire::kNj];
    const double* before = w > 0 ? position - wire::kNj : position;
    const double gap_s = w > 0 ? static_cast<double>(plan.t_ns[w] - plan.t_ns[w - 1]) * 1e-9 : 0.0;
    for (std::size_t j = 0; j < limits.joints; ++j) {
      const double fastest = limits.joint[j].velocity_max_rad_s * (1 + kRounding);
      inside &= position[j] >= limits.joint[j].position_min_rad - kRounding &&
                position[j] <= limits.joint[j].position_max_rad + kRounding;
      slow_enough &= !(std::abs(velocity[j]) > fastest);
      slow_enough &= std::abs(position[j] - before[j]) <= fastest * gap_s + kRounding;
    }
  }
  if (!inside) return PlanReject::position_limit;
  return slow_enough ? PlanReject::none : PlanReject::velocity_limit;
}

}  // namespace

void rest_joint(wire::Plan& plan, std::size_t joint, double position_rad) LITHE_RT {
  for (std::size_t at = joint; at < wire::kNw * wire::kNj; at += wire::kNj) {
    plan.position_rad[at] = position_rad;
    plan.velocity_rad_s[at] = 0;
  }
}

PlanReject check(const wire::Plan& plan, const Limits& limits, std::int64_t now_ns) LITHE_RT {
  if (plan.waypoint_count < 1 || plan.waypoint_count > wire::kNw) return PlanReject::count;
  if (plan.joint_count != limits.joints) return PlanReject::joints;
  if (const PlanReject reject = check_times(plan, now_ns); reject != PlanReject::none) return reject;
  // NaN and infinity fail the limits too, so a valid plan is read once; only an invalid one is examined for the reason.
  const PlanReject beyond = check_limits(plan, limits);
  if (beyond == PlanReject::none) return PlanReject::none;
  const PlanReject not_finite = check_finite(plan, limits.joints);
  return not_finite != PlanReject::none ? not_finite : beyond;
}

}  // namespace lithe::plan
