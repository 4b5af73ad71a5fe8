// SPDX-License-Identifier: Apache-2.0
#include "spine/plan/interpolator.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "spine/plan/tangent.hpp"

namespace lithe::plan {
namespace {

using wire::PlanReject;
using wire::PlanState;

constexpr std::int64_t kBlendNs = 50'000'000;
constexpr double kShortestBlendS = 0.05;
constexpr double kLongestBlendS = 0.5;
constexpr double kForever = std::numeric_limits<double>::infinity();

double seconds(std::int64_t ns) LITHE_RT { return static_cast<double>(ns) * 1e-9; }

}  // namespace

void Interpolator::configure(const robot::RobotConfig& robot) {
  *this = Interpolator();
  limits_.joints = std::min(robot.joints.size(), kMaxJoints);
  for (std::size_t j = 0; j < limits_.joints; ++j) {
    const robot::JointConfig& joint = robot.joints[j];
    limits_.position_min_rad[j] = joint.position_min_rad;
    limits_.position_max_rad[j] = joint.position_max_rad;
    limits_.velocity_max_rad_s[j] = joint.velocity_max_rad_s;
    deceleration_rad_s2_[j] = joint.deceleration_rad_s2;
    monotone_[j] = joint.monotone;
  }
}

PlanReject Interpolator::accept(const wire::Plan& plan, std::int64_t now_ns) LITHE_RT {
  if (const PlanReject reject = check(plan, limits_, now_ns); reject != PlanReject::none) return reject;
  JointArray position{}, velocity{}, acceleration{};
  const bool moving_on = state_ != PlanState::none;
  if (moving_on) {
    advance(now_ns);
    evaluate(now_ns, position, velocity, acceleration);
  }
  const bool starts_ahead = moving_on && plan.t_ns[0] - now_ns > kBlendNs;
  if (starts_ahead && !reachable(now_ns, plan, position)) return PlanReject::velocity_limit;

  copy(plan, starts_ahead ? 1 : 0);
  if (starts_ahead) {
    t_ns_[0] = now_ns;
    knot_rad_[0] = position;
    knot_rad_s_[0] = velocity;
  }
  blend_.until_ns = 0;
  state_ = PlanState::track;
  segment_ = 0;
  if (t_ns_[0] > now_ns) {
    lead_to_first();
  } else {
    enter_segment(0);
    advance(now_ns);
  }
  if (moving_on && !starts_ahead) start_blend(now_ns, position, velocity);
  return PlanReject::none;
}

void Interpolator::sample(std::int64_t now_ns, Setpoint& out) LITHE_RT {
  advance(now_ns);
  evaluate(now_ns, out.position_rad, out.velocity_rad_s, out.acceleration_rad_s2);
  out.state = state_;
}

void Interpolator::hold_at(const JointArray& position_rad) LITHE_RT {
  for (std::size_t j = 0; j < limits_.joints; ++j) {
    if (!std::isnan(position_rad[j])) {
      piece_.c0[j] = std::clamp(position_rad[j], limits_.position_min_rad[j], limits_.position_max_rad[j]);
    }
    piece_.c1[j] = piece_.c2[j] = piece_.c3[j] = piece_.last_s[j] = 0;
  }
  blend_.until_ns = 0;
  state_ = PlanState::hold;
}

void Interpolator::stop(std::int64_t now_ns) LITHE_RT {
  if (state_ == PlanState::none) return;
  JointArray position{}, velocity{}, acceleration{};
  advance(now_ns);
  evaluate(now_ns, position, velocity, acceleration);
  blend_.until_ns = 0;
  enter_coast(now_ns, position, velocity);
}

// Moves on to the segment or state that holds at `now_ns`.
void Interpolator::advance(std::int64_t now_ns) LITHE_RT {
  if (state_ == PlanState::track) {
    const std::size_t last = knots_ - 1;
    if (now_ns >= t_ns_[last]) {
      JointArray velocity{};
      for (std::size_t j = 0; j < limits_.joints; ++j) velocity[j] = tangent(last, j);
      const JointArray position = knot_rad_[last];
      enter_coast(t_ns_[last], position, velocity);
    } else if (now_ns >= t_ns_[0]) {
      std::size_t knot = segment_;
      while (knot + 1 < last && now_ns >= t_ns_[knot + 1]) ++knot;
      if (knot != segment_ || piece_.since_ns != t_ns_[knot] || piece_.last_s[0] != kForever) enter_segment(knot);
    }
  }
  if (state_ == PlanState::coast && now_ns >= coast_until_ns_) state_ = PlanState::hold;
}

void Interpolator::evaluate(std::int64_t now_ns, JointArray& position, JointArray& velocity,
                            JointArray& acceleration) const LITHE_RT {
  const double since_s = seconds(now_ns - piece_.since_ns);
  for (std::size_t j = 0; j < limits_.joints; ++j) {
    const double u = std::min(since_s, piece_.last_s[j]);
    const double moves = since_s < piece_.last_s[j] ? 1.0 : 0.0;
    position[j] = piece_.c0[j] + u * (piece_.c1[j] + u * (piece_.c2[j] + u * piece_.c3[j]));
    velocity[j] = moves * (piece_.c1[j] + u * (2 * piece_.c2[j] + u * 3 * piece_.c3[j]));
    acceleration[j] = moves * (2 * piece_.c2[j] + u * 6 * piece_.c3[j]);
  }
  if (now_ns < blend_.until_ns) {
    const double blend_s = seconds(now_ns - blend_.since_ns);
    for (std::size_t j = 0; j < limits_.joints; ++j) {
      const double rate = blend_.per_s[j];
      const double s = std::max(0.0, 1.0 - blend_s * rate);
      position[j] += s * s * (blend_.a[j] + s * blend_.b[j]);
      velocity[j] -= rate * s * (2 * blend_.a[j] + 3 * s * blend_.b[j]);
      acceleration[j] += s > 0 ? rate * rate * (2 * blend_.a[j] + 6 * s * blend_.b[j]) : 0.0;
    }
  }
  for (std::size_t j = 0; j < limits_.joints; ++j) {
    // At a limit the setpoint stands still until the curve comes back: no velocity that leads outwards.
    const double inside = std::clamp(position[j], limits_.position_min_rad[j], limits_.position_max_rad[j]);
    const bool outwards = (velocity[j] > 0 && inside >= limits_.position_max_rad[j]) ||
                          (velocity[j] < 0 && inside <= limits_.position_min_rad[j]);
    const double free = inside == position[j] && !outwards ? 1.0 : 0.0;
    position[j] = inside;
    velocity[j] *= free;
    acceleration[j] *= free;
  }
}

// Before a first waypoint that is near: its own velocity, backwards. The blend does the rest.
void Interpolator::lead_to_first() LITHE_RT {
  piece_.since_ns = t_ns_[0];
  for (std::size_t j = 0; j < limits_.joints; ++j) {
    piece_.c0[j] = knot_rad_[0][j];
    piece_.c1[j] = tangent(0, j);
    piece_.c2[j] = piece_.c3[j] = 0;
    piece_.last_s[j] = 0;  // only negative times are asked for; marks the piece as no segment
  }
}

void Interpolator::enter_segment(std::size_t knot) LITHE_RT {
  segment_ = knot;
  piece_.since_ns = t_ns_[knot];
  const double per_s = 1.0 / gap_s(knot);
  for (std::size_t j = 0; j < limits_.joints; ++j) {
    const double mean = rise(knot, j);
    const double from = tangent(knot, j);
    const double to = tangent(knot + 1, j);
    piece_.c0[j] = knot_rad_[knot][j];
    piece_.c1[j] = from;
    piece_.c2[j] = (3 * mean - 2 * from - to) * per_s;
    piece_.c3[j] = (from + to - 2 * mean) * per_s * per_s;
    piece_.last_s[j] = kForever;
  }
}

void Interpolator::enter_coast(std::int64_t from_ns, const JointArray& position, const JointArray& velocity) LITHE_RT {
  double longest_s = 0;
  piece_.since_ns = from_ns;
  for (std::size_t j = 0; j < limits_.joints; ++j) {
    const double speed = std::abs(velocity[j]);
    const double way_rad =
        velocity[j] > 0 ? limits_.position_max_rad[j] - position[j] : position[j] - limits_.position_min_rad[j];
    const double needed = speed * speed / (2 * std::max(way_rad, 1e-9));  // to stop before the limit
    const double slowing = std::max(deceleration_rad_s2_[j], needed);
    piece_.c0[j] = position[j];
    piece_.c1[j] = velocity[j];
    piece_.c2[j] = -0.5 * std::copysign(slowing, velocity[j]);
    piece_.c3[j] = 0;
    piece_.last_s[j] = speed / slowing;
    longest_s = std::max(longest_s, piece_.last_s[j]);
  }
  coast_until_ns_ = std::max(from_ns + static_cast<std::int64_t>(longest_s * 1e9), blend_.until_ns);
  state_ = PlanState::coast;
}

void Interpolator::start_blend(std::int64_t now_ns, const JointArray& position, const JointArray& velocity) LITHE_RT {
  JointArray new_position{}, new_velocity{}, acceleration{};
  evaluate(now_ns, new_position, new_velocity, acceleration);
  double longest_s = 0;
  for (std::size_t j = 0; j < limits_.joints; ++j) {
    const double gap_rad = position[j] - new_position[j];
    const double gap_rad_s = velocity[j] - new_velocity[j];
    // Long enough to stay near the joint's own deceleration and well below its velocity limit.
    const double gentle = std::max(std::sqrt(6 * std::abs(gap_rad) / deceleration_rad_s2_[j]),
                                   4 * std::abs(gap_rad_s) / deceleration_rad_s2_[j]);
    const double slow = 3 * std::abs(gap_rad) / limits_.velocity_max_rad_s[j];
    const double lasts_s = std::clamp(std::max(gentle, slow), kShortestBlendS, kLongestBlendS);
    blend_.a[j] = 3 * gap_rad + lasts_s * gap_rad_s;
    blend_.b[j] = -2 * gap_rad - lasts_s * gap_rad_s;
    blend_.per_s[j] = 1 / lasts_s;
    longest_s = std::max(longest_s, lasts_s);
  }
  blend_.since_ns = now_ns;
  blend_.until_ns = now_ns + static_cast<std::int64_t>(longest_s * 1e9);
  if (state_ == PlanState::coast) coast_until_ns_ = std::max(coast_until_ns_, blend_.until_ns);
}

void Interpolator::copy(const wire::Plan& plan, std::size_t first_knot) LITHE_RT {
  for (std::size_t w = 0; w < plan.waypoint_count; ++w) {
    t_ns_[first_knot + w] = plan.t_ns[w];
    for (std::size_t j = 0; j < limits_.joints; ++j) {
      knot_rad_[first_knot + w][j] = plan.position_rad[w * wire::kNj + j];
      knot_rad_s_[first_knot + w][j] = plan.velocity_rad_s[w * wire::kNj + j];
    }
  }
  knots_ = first_knot + plan.waypoint_count;
  streaming_ = plan.streaming != 0;
  plan_id_ = plan.plan_id;
}

bool Interpolator::reachable(std::int64_t now_ns, const wire::Plan& plan, const JointArray& position) const LITHE_RT {
  const double time_s = seconds(plan.t_ns[0] - now_ns);
  bool slow_enough = true;
  for (std::size_t j = 0; j < limits_.joints; ++j) {
    slow_enough &= std::abs(plan.position_rad[j] - position[j]) <= limits_.velocity_max_rad_s[j] * time_s;
  }
  return slow_enough;
}

double Interpolator::gap_s(std::size_t knot) const LITHE_RT { return seconds(t_ns_[knot + 1] - t_ns_[knot]); }

double Interpolator::rise(std::size_t knot, std::size_t j) const LITHE_RT {
  return (knot_rad_[knot + 1][j] - knot_rad_[knot][j]) / gap_s(knot);
}

// The velocity at a knot: given by the plan, or 0 at the end of a plan that is not continued, or from the neighbours.
double Interpolator::tangent(std::size_t knot, std::size_t j) const LITHE_RT {
  if (!std::isnan(knot_rad_s_[knot][j])) return knot_rad_s_[knot][j];
  const std::size_t last = knots_ - 1;
  if (last == 0 || (knot == last && !streaming_)) return 0;
  if (last == 1) return rise(0, j);
  const bool at_end = knot == 0 || knot == last;
  const std::size_t near = knot == last ? last - 1 : (knot == 0 ? 0 : knot - 1);
  const std::size_t far = knot == last ? last - 2 : (knot == 0 ? 1 : knot);
  if (monotone_[j]) {
    return at_end ? end_tangent_monotone(gap_s(near), rise(near, j), gap_s(far), rise(far, j))
                  : inner_tangent_monotone(gap_s(near), rise(near, j), gap_s(far), rise(far, j));
  }
  return at_end ? end_tangent(gap_s(near), rise(near, j), gap_s(far), rise(far, j))
                : inner_tangent(gap_s(near), rise(near, j), gap_s(far), rise(far, j));
}

}  // namespace lithe::plan
