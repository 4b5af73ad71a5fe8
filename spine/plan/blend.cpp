// SPDX-License-Identifier: Apache-2.0
#include "spine/plan/blend.hpp"

#include <cmath>

#include "spine/plan/knots.hpp"

namespace lithe::plan {
namespace {

// `arc` and the decay on top of it, both over time since now; arc_s is the arc's own zero on that axis.
double fastest_of_both(const Arc& arc, double arc_s, const Decay& decay, double from_s, double to_s) LITHE_RT {
  if (from_s >= to_s) return 0;
  const auto speed = [&](double t_s) LITHE_RT { return arc.velocity(t_s - arc_s) + decay.velocity(decay.left(t_s)); };
  return peak(speed(from_s), speed(0.5 * (from_s + to_s)), speed(to_s));
}

}  // namespace

Arc Course::start() const LITHE_RT {
  const std::size_t knot = knots.segment_at(now_ns);
  const Arc arc = now_ns < knots.t_ns[0] ? knots.lead[j] : knots.arc(knot, j);
  const double u = static_cast<double>(now_ns - knots.t_ns[knot]) * 1e-9;
  return {arc.position(u), arc.velocity(u), arc.c2 + 3 * u * arc.c3, arc.c3};
}

double Course::fastest_under(const Decay& decay) const LITHE_RT {
  const double end_s = 1 / decay.per_s;
  const auto since_now = [&](std::int64_t t_ns) LITHE_RT { return static_cast<double>(t_ns - now_ns) * 1e-9; };
  double fastest = 0;
  double from_s = std::min(end_s, std::max(0.0, since_now(knots.t_ns[0])));
  fastest = std::max(fastest, fastest_of_both(knots.lead[j], since_now(knots.t_ns[0]), decay, 0, from_s));
  for (std::size_t knot = knots.segment_at(now_ns); knot + 1 < knots.count && from_s < end_s; ++knot) {
    const double to_s = std::min(end_s, since_now(knots.t_ns[knot + 1]));
    const double both = fastest_of_both(knots.arc(knot, j), since_now(knots.t_ns[knot]), decay, from_s, to_s);
    fastest = std::max(fastest, both);
    from_s = to_s;
  }
  const double last_rad_s = knots.rad_s[knots.count - 1][j];
  const double rest_s = std::min(end_s, from_s + std::abs(last_rad_s) / slowing_rad_s2);
  const Arc coast{0, last_rad_s, -0.5 * std::copysign(slowing_rad_s2, last_rad_s), 0};
  fastest = std::max(fastest, fastest_of_both(coast, from_s, decay, from_s, rest_s));
  return std::max(fastest, fastest_of_both({0, 0, 0, 0}, 0, decay, rest_s, end_s));
}

}  // namespace lithe::plan
