// SPDX-License-Identifier: Apache-2.0
// Held plans: the setpoint steps to each waypoint at its time, and stays there.
#include <algorithm>
#include <cmath>

#include "spine/plan/interpolator.hpp"

namespace lithe::plan {

using wire::PlanState;

void Interpolator::hold_plan(const wire::Plan& plan, std::int64_t now_ns) LITHE_RT {
  if (held_ == Held::on) {
    advance(now_ns);  // what holds stays
  } else {
    stop(now_ns);
    held_ = Held::ahead;
  }
  Knots& next = knots_[1 - used_];
  next.count = 0;
  next.add(plan, limits_.joints);
  used_ = 1 - used_;
  segment_ = 0;
  plan_id_ = plan.plan_id;
}

void Interpolator::advance_held(std::int64_t now_ns) LITHE_RT {
  const Knots& k = knots();
  std::size_t due = segment_;
  while (due < k.count && now_ns >= k.t_ns[due]) ++due;
  if (due > segment_) step_to(due - 1, now_ns);
  segment_ = due;
  if (held_ == Held::on) state_ = held_for_ns(now_ns) < limits_.stale_ns ? PlanState::track : PlanState::hold;
}

void Interpolator::step_to(std::size_t knot, std::int64_t now_ns) LITHE_RT {
  Setpoint from;
  evaluate(now_ns, from);
  const Knots& k = knots();
  for (std::size_t j = 0; j < limits_.joints; ++j) {
    const JointLimits& limit = limits_.joint[j];
    const double rad = std::clamp(k.rad[knot][j], limit.position_min_rad, limit.position_max_rad);
    setpoint_.stepped_rad[j] += rad - from.position_rad[j];
    setpoint_.step_rad_s[j] += (rad - from.position_rad[j]) / kStepS;
    piece_.arc[j] = {rad, 0, 0, 0};
    piece_.last_s[j] = 0;
    held_rad_s_[j] = std::isnan(k.rad_s[knot][j]) ? 0.0 : k.rad_s[knot][j];
  }
  piece_.since_ns = k.t_ns[knot];
  blend_.until_ns = 0;
  stop_catching_up();
  held_ = Held::on;
  stepped_ = true;
}

void Interpolator::fade_steps(std::int64_t now_ns) LITHE_RT {
  constexpr double kNothing = 1e-9;  // becomes 0: denormal numbers are slow
  const double since_s = static_cast<double>(now_ns - faded_to_ns_) * 1e-9;
  faded_to_ns_ = now_ns;
  const double left = std::max(0.0, 1 - since_s / kStepS);
  for (std::size_t j = 0; j < limits_.joints; ++j) {
    double &stepped = setpoint_.stepped_rad[j], &speed = setpoint_.step_rad_s[j];
    const double rad = std::abs(stepped);
    const double rad_s = std::min(rad / kStepFadesS, 0.5 * limits_.joint[j].velocity_max_rad_s);
    stepped = rad < kNothing ? 0.0 : stepped - std::copysign(std::min(rad, rad_s * since_s), stepped);
    speed = std::abs(speed) < kNothing ? 0.0 : speed * left;
  }
}

}  // namespace lithe::plan
