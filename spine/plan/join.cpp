// SPDX-License-Identifier: Apache-2.0
// Joins the present motion to a new plan: by a blend, or by catching up.
#include <algorithm>
#include <cmath>

#include "spine/plan/interpolator.hpp"

namespace lithe::plan {
namespace {

using wire::PlanState;

constexpr double kShortestBlendS = 0.05;
constexpr double kLongestBlendS = 0.5;

}  // namespace

void Interpolator::Blend::add(std::size_t j, std::int64_t now_ns, const Decay& decay) LITHE_RT {
  since_ns[j] = now_ns;
  joint[j] = decay;
  until_ns = std::max(until_ns, now_ns + static_cast<std::int64_t>(1e9 / decay.per_s));
}

// Limits for catching up, from knot `first` on.
double Interpolator::most_rad_s2(const Knots& knots, std::size_t first, std::size_t j) const LITHE_RT {
  return std::max(deceleration_rad_s2_[j], 2 * knots.hardest(first, j));
}

// Of the knots that are tried: whether the cubic from the present motion to the first waypoint of a stream is harder
// than catching up would be, or too fast. The first waypoint's velocity, and so the segment behind it, is of the lead's
// making as well: the plan's own begins with the one after that.
bool Interpolator::lead_is_harsh(const JointArray& most_rad_s) const LITHE_RT {
  const Knots& next = knots_[1 - used_];
  for (std::size_t j = 0; j < limits_.joints; ++j) {
    const Arc lead = next.arc(0, j);
    const double length_s = next.gap_s(0);
    const double ends = std::max(std::abs(2 * lead.c2), std::abs(2 * lead.c2 + 6 * lead.c3 * length_s));
    if (ends > most_rad_s2(next, 2, j)) return true;
    if (next.fastest_on(0, 0, j) > most_rad_s[j]) return true;
  }
  return false;
}

void Interpolator::join(const Knots& next, std::int64_t now_ns, const Setpoint& from, const JointArray& bound_rad_s,
                        const JointArray& most_rad_s) LITHE_RT {
  const std::size_t last = next.count - 1;
  const std::size_t first = next.segment_at(now_ns);
  Blend blend;
  catching_up_ = false;
  for (std::size_t j = 0; j < limits_.joints; ++j) {
    const Course course{next, now_ns, j, slowing(j, next.rad[last][j], next.rad_s[last][j])};
    const Arc start = course.start();
    const double gap_rad = from.position_rad[j] - start.c0;
    const double gap_rad_s = from.velocity_rad_s[j] - start.c1;
    const auto too_fast = [&](const Decay& decay) LITHE_RT {
      return bound_rad_s[j] + decay.bound_speed() > most_rad_s[j] && course.fastest_under(decay) > most_rad_s[j];
    };
    // Long enough to stay near the joint's own deceleration and well below its velocity limit.
    const double gentle = std::max(std::sqrt(6 * std::abs(gap_rad) / deceleration_rad_s2_[j]),
                                   4 * std::abs(gap_rad_s) / deceleration_rad_s2_[j]);
    const double slow = 3 * std::abs(gap_rad) / limits_.joint[j].velocity_max_rad_s;
    const double lasts_s = std::max({gentle, slow, kShortestBlendS});
    Decay decay = Decay::over(gap_rad, gap_rad_s, std::min(lasts_s, kLongestBlendS));
    const bool fits = lasts_s <= kLongestBlendS && !catch_up_[j].on;
    if (fits && too_fast(decay)) decay = Decay::over(gap_rad, gap_rad_s, kLongestBlendS);
    if (fits && !too_fast(decay)) {
      blend.add(j, now_ns, decay);
      continue;
    }
    const double was_rad_s2 = catch_up_[j].on ? catch_up_[j].acceleration_rad_s2 : 0.0;
    catch_up_[j] = {true, from.position_rad[j], from.velocity_rad_s[j], was_rad_s2, most_rad_s2(next, first, j)};
    catching_up_ = true;
  }
  blend_ = blend;
  caught_up_to_ns_ = now_ns;
}

void Interpolator::stop_catching_up() LITHE_RT {
  catching_up_ = false;
  for (CatchUp& joint : catch_up_) joint.on = false;
}

void Interpolator::catch_up(std::int64_t now_ns) LITHE_RT {
  const double dt_s = static_cast<double>(now_ns - caught_up_to_ns_) * 1e-9;
  if (dt_s <= 0) return;
  caught_up_to_ns_ = now_ns;
  Setpoint curve;
  follow_curve(now_ns, curve);
  Setpoint goal = curve;
  keep_inside(goal);
  catching_up_ = false;
  for (std::size_t j = 0; j < limits_.joints; ++j) {
    CatchUp& joint = catch_up_[j];
    if (!joint.on) continue;
    joint.step(goal.position_rad[j], goal.velocity_rad_s[j], dt_s, limits_.joint[j]);
    // A blend lies on top of the curve itself, which may be beyond a limit.
    const double curve_rad_s = curve.velocity_rad_s[j];
    joint.on = !blend_the_rest(j, now_ns, joint.position_rad - curve.position_rad[j],
                               joint.velocity_rad_s - curve_rad_s, curve_rad_s);
    catching_up_ = catching_up_ || joint.on;
  }
}

// Once a blend needs no more than the half of the acceleration that the plan itself leaves.
bool Interpolator::blend_the_rest(std::size_t j, std::int64_t now_ns, double gap_rad, double gap_rad_s,
                                  double curve_rad_s) LITHE_RT {
  const double half_rad_s2 = 0.5 * catch_up_[j].most_rad_s2;
  const double gentle =
      std::max(std::sqrt(12 * std::abs(gap_rad) / half_rad_s2), 8 * std::abs(gap_rad_s) / half_rad_s2);
  if (gentle > kLongestBlendS) return false;
  const Decay decay = Decay::over(gap_rad, gap_rad_s, std::max(gentle, kShortestBlendS));
  const double limit_rad_s = limits_.joint[j].velocity_max_rad_s;
  if (state_ != PlanState::track && std::abs(curve_rad_s) + decay.bound_speed() > limit_rad_s) return false;
  if (state_ == PlanState::track) {
    const std::size_t last = knots().count - 1;
    const Course course{knots(), now_ns, j, slowing(j, knots().rad[last][j], knots().rad_s[last][j])};
    if (course.fastest_under(decay) > limit_rad_s) return false;
  }
  blend_.add(j, now_ns, decay);
  coast_until_ns_ = std::max(coast_until_ns_, blend_.until_ns);
  return true;
}

}  // namespace lithe::plan
