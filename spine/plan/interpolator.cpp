// SPDX-License-Identifier: Apache-2.0
#include "spine/plan/interpolator.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

namespace lithe::plan {
namespace {

using wire::PlanReject;
using wire::PlanState;

constexpr std::int64_t kBlendNs = 50'000'000;
constexpr double kSpeedRounding = 0.5e-9;  // relative, of a speed at its limit
constexpr double kForever = std::numeric_limits<double>::infinity();

double seconds(std::int64_t ns) LITHE_RT { return static_cast<double>(ns) * 1e-9; }

}  // namespace

void Interpolator::configure(const robot::RobotConfig& robot) {
  *this = Interpolator();
  limits_.joints = std::min(robot.joints.size(), kMaxJoints);
  limits_.stale_ns = std::llround(1e9 * robot.brain.stale_after_s);
  for (std::size_t j = 0; j < limits_.joints; ++j) {
    const robot::JointConfig& joint = robot.joints[j];
    limits_.joint[j] = {joint.position_min_rad, joint.position_max_rad, joint.velocity_max_rad_s};
    deceleration_rad_s2_[j] = joint.deceleration_rad_s2;
    monotone_[j] = joint.monotone;
  }
}

wire::PlanDecision Interpolator::accept(const wire::Plan& plan, std::int64_t now_ns) LITHE_RT {
  const wire::PlanDecision checked = check(plan, limits_, now_ns);
  if (reason_of(checked) != PlanReject::none) return checked;
  if (is_held(plan)) {
    hold_plan(plan, now_ns);
    return checked;
  }
  Setpoint from;
  JointArray most_rad_s{};
  const bool moving_on = state_ != PlanState::none;
  if (moving_on) {
    advance(now_ns);
    evaluate(now_ns, from);
  }
  for (std::size_t j = 0; j < limits_.joints; ++j)
    most_rad_s[j] =
        std::max(limits_.joint[j].velocity_max_rad_s * (1 + kSpeedRounding), std::abs(from.velocity_rad_s[j]));
  std::uint32_t ahead = 0;  // the first waypoint that is
  while (plan.t_ns[ahead] <= now_ns) ++ahead;
  const bool may_catch_up = plan.streaming != 0 && plan.waypoint_count - ahead > 2;
  bool leads = moving_on && plan.t_ns[0] - now_ns > kBlendNs;
  if (moving_on && !leads && !may_catch_up) {
    const wire::PlanDecision near = check_way_to(plan, ahead, now_ns, from);
    if (reason_of(near) != PlanReject::none) return near;
  }
  lay_knots(plan, now_ns, leads ? &from : nullptr);
  if (leads && may_catch_up && lead_is_harsh(most_rad_s)) {
    leads = false;
    lay_knots(plan, now_ns, nullptr);
  }
  Knots& next = knots_[1 - used_];
  next.choose_leads(now_ns, limits_.joints, from.velocity_rad_s, most_rad_s);
  JointArray bound_rad_s{};
  next.bound_speed(now_ns, limits_.joints, bound_rad_s);
  for (std::size_t j = 0; j < limits_.joints; ++j)
    if (bound_rad_s[j] > most_rad_s[j] && next.fastest(now_ns, j) > most_rad_s[j])
      return too_fast(now_ns, j, most_rad_s[j], leads);

  if (moving_on && !leads) {
    join(next, now_ns, from, bound_rad_s, most_rad_s);
  } else {
    blend_ = Blend{};
    stop_catching_up();
  }
  used_ = 1 - used_;
  held_ = Held::no;
  plan_id_ = plan.plan_id;
  state_ = PlanState::track;
  if (next.t_ns[0] > now_ns) {
    segment_ = 0;
    lead_to_first();
  } else {
    enter_segment(next.segment_at(now_ns));
  }
  return checked;
}

// From the present setpoint to this waypoint, which no curve leads to: a blend begins at once, however near it is.
wire::PlanDecision Interpolator::check_way_to(const wire::Plan& plan, std::uint32_t waypoint, std::int64_t now_ns,
                                              const Setpoint& from) const LITHE_RT {
  for (std::size_t j = 0; j < limits_.joints; ++j) {
    const double way_rad = plan.position_rad[waypoint * wire::kNj + j] - from.position_rad[j];
    wire::PlanDecision out = check_way(way_rad, plan.t_ns[waypoint] - now_ns, limits_.joint[j].velocity_max_rad_s);
    if (reason_of(out) == PlanReject::none) continue;
    out.joint = static_cast<std::uint32_t>(j);
    out.waypoint = waypoint;
    return out;
  }
  return decision(PlanReject::none);
}

// Of the next knots, whose curve is faster than this: on the first such way.
wire::PlanDecision Interpolator::too_fast(std::int64_t now_ns, std::size_t j, double most_rad_s, bool leads) const
    LITHE_RT {
  const Knots& next = knots_[1 - used_];
  std::size_t knot = next.segment_at(now_ns);
  const auto fastest = [&]() LITHE_RT {
    return next.fastest_on(knot, std::max(0.0, seconds(now_ns - next.t_ns[knot])), j);
  };
  double fastest_rad_s = fastest();
  while (knot + 2 < next.count && fastest_rad_s <= most_rad_s) {
    ++knot;
    fastest_rad_s = fastest();
  }
  wire::PlanDecision out = decision(PlanReject::velocity_limit, fastest_rad_s, limits_.joint[j].velocity_max_rad_s);
  out.joint = static_cast<std::uint32_t>(j);
  out.waypoint = static_cast<std::uint32_t>(leads ? knot : knot + 1);  // the one at its end
  out.way_rad = next.rad[knot + 1][j] - next.rad[knot][j];
  out.needs_s = next.gap_s(knot) * out.value / out.limit;
  return out;
}

// The knots of `plan`, where the next plan is tried; behind the present motion, if it is given.
void Interpolator::lay_knots(const wire::Plan& plan, std::int64_t now_ns, const Setpoint* from) LITHE_RT {
  Knots& next = knots_[1 - used_];
  next.count = 0;
  if (from != nullptr) next.add(now_ns, from->position_rad, from->velocity_rad_s);
  next.add(plan, limits_.joints);
  next.choose_velocities(limits_, monotone_, plan.streaming != 0, next.segment_at(now_ns));
}

const Setpoint& Interpolator::sample(std::int64_t now_ns) LITHE_RT {
  fade_steps(now_ns);
  advance(now_ns);
  evaluate(now_ns, setpoint_);
  if (held_ == Held::on && state_ == PlanState::track) {
    setpoint_.velocity_rad_s = held_rad_s_;
    keep_inside(setpoint_);
  }
  setpoint_.steps = std::exchange(stepped_, false);
  setpoint_.state = state_;
  return setpoint_;
}

void Interpolator::hold_at(const JointArray& position_rad) LITHE_RT {
  for (std::size_t j = 0; j < limits_.joints; ++j) {
    const double rad = std::isnan(position_rad[j]) ? piece_.arc[j].c0 : position_rad[j];
    piece_.arc[j] = {std::clamp(rad, limits_.joint[j].position_min_rad, limits_.joint[j].position_max_rad), 0, 0, 0};
    piece_.last_s[j] = 0;
  }
  blend_.until_ns = 0;
  stop_catching_up();
  held_ = Held::no;
  setpoint_.stepped_rad.fill(0.0);
  setpoint_.step_rad_s.fill(0.0);
  state_ = PlanState::hold;
}

void Interpolator::stop(std::int64_t now_ns) LITHE_RT {
  if (state_ == PlanState::none) return;
  Setpoint from;
  advance(now_ns);
  evaluate(now_ns, from);
  blend_.until_ns = 0;
  stop_catching_up();
  held_ = Held::no;
  enter_coast(now_ns, from.position_rad, from.velocity_rad_s);
}

// Moves on to the segment or state that holds at `now_ns`.
void Interpolator::advance(std::int64_t now_ns) LITHE_RT {
  if (held_ != Held::no) {
    advance_held(now_ns);
  } else if (state_ == PlanState::track) {
    const Knots& k = knots();
    const std::size_t last = k.count - 1;
    if (now_ns >= k.t_ns[last]) {
      enter_coast(k.t_ns[last], k.rad[last], k.rad_s[last]);
    } else if (now_ns >= k.t_ns[0]) {
      std::size_t knot = segment_;
      while (knot + 1 < last && now_ns >= k.t_ns[knot + 1]) ++knot;
      if (knot != segment_ || piece_.since_ns != k.t_ns[knot] || piece_.last_s[0] != kForever) enter_segment(knot);
    }
  }
  if (catching_up_) catch_up(now_ns);
  if (state_ == PlanState::coast && now_ns >= coast_until_ns_ && !catching_up_) state_ = PlanState::hold;
}

void Interpolator::evaluate(std::int64_t now_ns, Setpoint& out) const LITHE_RT {
  follow_curve(now_ns, out);
  if (catching_up_) {
    for (std::size_t j = 0; j < limits_.joints; ++j) {
      if (!catch_up_[j].on) continue;
      out.position_rad[j] = catch_up_[j].position_rad;
      out.velocity_rad_s[j] = catch_up_[j].velocity_rad_s;
      out.acceleration_rad_s2[j] = catch_up_[j].acceleration_rad_s2;
    }
  }
  keep_inside(out);
}

void Interpolator::follow_curve(std::int64_t now_ns, Setpoint& out) const LITHE_RT {
  const double since_s = seconds(now_ns - piece_.since_ns);
  for (std::size_t j = 0; j < limits_.joints; ++j) {
    const double u = std::min(since_s, piece_.last_s[j]);
    const double moves = since_s < piece_.last_s[j] ? 1.0 : 0.0;
    out.position_rad[j] = piece_.arc[j].position(u);
    out.velocity_rad_s[j] = moves * piece_.arc[j].velocity(u);
    out.acceleration_rad_s2[j] = moves * piece_.arc[j].acceleration(u);
  }
  if (now_ns < blend_.until_ns) {
    for (std::size_t j = 0; j < limits_.joints; ++j) {
      const Decay& decay = blend_.joint[j];
      const double s = decay.left(seconds(now_ns - blend_.since_ns[j]));
      out.position_rad[j] += decay.position(s);
      out.velocity_rad_s[j] += decay.velocity(s);
      out.acceleration_rad_s2[j] += decay.acceleration(s);
    }
  }
}

void Interpolator::keep_inside(Setpoint& out) const LITHE_RT {
  for (std::size_t j = 0; j < limits_.joints; ++j) {
    const JointLimits& limit = limits_.joint[j];
    // At a limit the setpoint stands still until the curve comes back: no velocity that leads outwards.
    const double rad = out.position_rad[j], rad_s = out.velocity_rad_s[j];
    const double inside = std::clamp(rad, limit.position_min_rad, limit.position_max_rad);
    const bool outwards =
        (rad_s > 0 && inside >= limit.position_max_rad) || (rad_s < 0 && inside <= limit.position_min_rad);
    const double free = inside == rad && !outwards ? 1.0 : 0.0;
    out.position_rad[j] = inside;
    out.velocity_rad_s[j] *= free;
    out.acceleration_rad_s2[j] *= free;
  }
}

// Before a first waypoint that is near. The blend does the rest.
void Interpolator::lead_to_first() LITHE_RT {
  piece_.since_ns = knots().t_ns[0];
  for (std::size_t j = 0; j < limits_.joints; ++j) {
    piece_.arc[j] = knots().lead[j];
    piece_.last_s[j] = 0;  // only negative times are asked for; marks the piece as no segment
  }
}

void Interpolator::enter_segment(std::size_t knot) LITHE_RT {
  segment_ = knot;
  piece_.since_ns = knots().t_ns[knot];
  for (std::size_t j = 0; j < limits_.joints; ++j) {
    piece_.arc[j] = knots().arc(knot, j);
    piece_.last_s[j] = kForever;
  }
}

// How hard joint j brakes when it is left alone: by its own deceleration, harder only to stop before its limit.
double Interpolator::slowing(std::size_t j, double position_rad, double velocity_rad_s) const LITHE_RT {
  const double way_rad = velocity_rad_s > 0 ? limits_.joint[j].position_max_rad - position_rad
                                            : position_rad - limits_.joint[j].position_min_rad;
  return std::max(deceleration_rad_s2_[j], velocity_rad_s * velocity_rad_s / (2 * std::max(way_rad, 1e-9)));
}

void Interpolator::enter_coast(std::int64_t from_ns, const JointArray& position, const JointArray& velocity) LITHE_RT {
  double longest_s = 0;
  piece_.since_ns = from_ns;
  for (std::size_t j = 0; j < limits_.joints; ++j) {
    const double brake = slowing(j, position[j], velocity[j]);
    piece_.arc[j] = {position[j], velocity[j], -0.5 * std::copysign(brake, velocity[j]), 0};
    piece_.last_s[j] = std::abs(velocity[j]) / brake;
    longest_s = std::max(longest_s, piece_.last_s[j]);
  }
  coast_until_ns_ = std::max(from_ns + static_cast<std::int64_t>(longest_s * 1e9), blend_.until_ns);
  state_ = PlanState::coast;
}

}  // namespace lithe::plan
