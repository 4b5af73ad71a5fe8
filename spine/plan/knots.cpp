// SPDX-License-Identifier: Apache-2.0
#include "spine/plan/knots.hpp"

#include <algorithm>
#include <cmath>

namespace lithe::plan {

void Knots::add(std::int64_t at_ns, const JointArray& position_rad, const JointArray& velocity_rad_s) LITHE_RT {
  t_ns[count] = at_ns;
  rad[count] = position_rad;
  rad_s[count] = velocity_rad_s;
  ++count;
}

void Knots::add(const wire::Plan& plan, std::size_t joints) LITHE_RT {
  for (std::size_t w = 0; w < plan.waypoint_count && count < kMost; ++w, ++count) {
    t_ns[count] = plan.t_ns[w];
    for (std::size_t j = 0; j < joints; ++j) {
      rad[count][j] = plan.position_rad[w * wire::kNj + j];
      rad_s[count][j] = plan.velocity_rad_s[w * wire::kNj + j];
    }
  }
}

void Knots::measure(std::size_t joints) LITHE_RT {
  for (std::size_t knot = 0; knot + 1 < count; ++knot) {
    per_s_[knot] = 1.0 / gap_s(knot);
    for (std::size_t j = 0; j < joints; ++j) rise_[knot][j] = (rad[knot + 1][j] - rad[knot][j]) * per_s_[knot];
  }
}

void Knots::choose_velocities(const Limits& limits, const std::array<bool, kMaxJoints>& monotone, bool streaming,
                              std::size_t first) LITHE_RT {
  measure(limits.joints);
  for (std::size_t knot = first; knot < count; ++knot) {
    const bool rests = count == 1 || (knot + 1 == count && !streaming);
    for (std::size_t j = 0; j < limits.joints; ++j) {
      if (!std::isnan(rad_s[knot][j])) continue;
      const double most = limits.joint[j].velocity_max_rad_s;
      rad_s[knot][j] = rests ? 0.0 : std::clamp(velocity_from_neighbours(knot, j, monotone[j]), -most, most);
    }
  }
}

double Knots::velocity_from_neighbours(std::size_t knot, std::size_t j, bool monotone) const LITHE_RT {
  const std::size_t last = count - 1;
  if (last == 1) return rise_[0][j];
  const bool at_end = knot == 0 || knot == last;
  const std::size_t near = knot == last ? last - 1 : (knot == 0 ? 0 : knot - 1);
  const std::size_t far = knot == last ? last - 2 : (knot == 0 ? 1 : knot);
  const double near_s = gap_s(near), far_s = gap_s(far), rise_near = rise_[near][j], rise_far = rise_[far][j];
  if (monotone) {
    return at_end ? end_tangent_monotone(near_s, rise_near, far_s, rise_far)
                  : inner_tangent_monotone(near_s, rise_near, far_s, rise_far);
  }
  return at_end ? end_tangent(near_s, rise_near, far_s, rise_far) : inner_tangent(near_s, rise_near, far_s, rise_far);
}

void Knots::choose_leads(std::int64_t now_ns, std::size_t joints, const JointArray& now_rad_s,
                         const JointArray& most_rad_s) LITHE_RT {
  const double from_s = static_cast<double>(now_ns - t_ns[0]) * 1e-9;
  if (from_s >= 0) return;
  for (std::size_t j = 0; j < joints; ++j) {
    const Arc steady{rad[0][j], rad_s[0][j], 0, 0};
    lead[j] = count > 1 ? arc(0, j) : steady;
    const auto gap_rad_s = [&](const Arc& a) LITHE_RT { return std::abs(now_rad_s[j] - a.velocity(from_s)); };
    const bool nearer = gap_rad_s(lead[j]) < gap_rad_s(steady);
    const bool gentle = std::abs(lead[j].acceleration(from_s)) <= 2 * hardest(0, j);
    if (!nearer || !gentle || fastest_lead(from_s, j) > most_rad_s[j]) lead[j] = steady;
  }
}

std::size_t Knots::segment_at(std::int64_t now_ns) const LITHE_RT {
  std::size_t knot = 0;
  while (knot + 2 < count && now_ns >= t_ns[knot + 1]) ++knot;
  return knot;
}

Arc Knots::arc(std::size_t knot, std::size_t j) const LITHE_RT {
  const double per_s = per_s_[knot];
  const double mean = rise_[knot][j];
  const double from = rad_s[knot][j];
  const double to = rad_s[knot + 1][j];
  return {rad[knot][j], from, (3 * mean - 2 * from - to) * per_s, (from + to - 2 * mean) * per_s * per_s};
}

void Knots::bound_speed(std::int64_t now_ns, std::size_t joints, JointArray& bound_rad_s) const LITHE_RT {
  const double lead_s = static_cast<double>(now_ns - t_ns[0]) * 1e-9;
  for (std::size_t j = 0; j < joints; ++j)
    bound_rad_s[j] = std::max(std::abs(rad_s[count - 1][j]), lead_s < 0 ? fastest_lead(lead_s, j) : 0.0);
  for (std::size_t knot = segment_at(now_ns); knot + 1 < count; ++knot) {
    for (std::size_t j = 0; j < joints; ++j) {
      // A parabola stays between its ends and the corner where its end tangents meet.
      const double corner = 3 * rise_[knot][j] - rad_s[knot][j] - rad_s[knot + 1][j];
      bound_rad_s[j] = std::max(bound_rad_s[j], std::max(std::abs(corner), std::abs(rad_s[knot][j])));
    }
  }
}

double Knots::fastest(std::int64_t now_ns, std::size_t j) const LITHE_RT {
  double fastest = 0;
  for (std::size_t knot = segment_at(now_ns); knot + 1 < count; ++knot)
    fastest = std::max(fastest, fastest_on(knot, std::max(0.0, static_cast<double>(now_ns - t_ns[knot]) * 1e-9), j));
  return fastest;
}

double Knots::fastest_on(std::size_t knot, double from_s, std::size_t j) const LITHE_RT {
  const double length_s = gap_s(knot);
  const Arc a = arc(knot, j);
  return peak(a.velocity(from_s), a.velocity(0.5 * (from_s + length_s)), a.velocity(length_s));
}

double Knots::hardest(std::size_t first, std::size_t j) const LITHE_RT {
  double hardest = 0;
  for (std::size_t knot = first; knot + 1 < count; ++knot) {
    const Arc a = arc(knot, j);
    hardest = std::max({hardest, std::abs(2 * a.c2), std::abs(2 * a.c2 + 6 * a.c3 * gap_s(knot))});
  }
  return hardest;
}

}  // namespace lithe::plan
