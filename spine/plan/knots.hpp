// SPDX-License-Identifier: Apache-2.0
// The knots of one plan, a velocity at each, and the curve between them.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "spine/core/joints.hpp"
#include "spine/core/rt.hpp"
#include "spine/plan/check.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::plan {

// One joint between two knots: position = c0 + u (c1 + u (c2 + u c3)), u in seconds since the first of them.
struct Arc {
  double c0 = 0, c1 = 0, c2 = 0, c3 = 0;
  double position(double u) const LITHE_RT { return c0 + u * (c1 + u * (c2 + u * c3)); }
  double velocity(double u) const LITHE_RT { return c1 + u * (2 * c2 + u * 3 * c3); }
  double acceleration(double u) const LITHE_RT { return 2 * c2 + u * 6 * c3; }
};

// All velocities in this room are piecewise parabolas over time.
// The largest magnitude of the parabola through three values at the start, the middle and the end of an interval.
inline double peak(double start, double middle, double end) LITHE_RT {
  const double bend = 2 * (start - 2 * middle + end);  // over x = 0..1: start + slope x + bend x^2
  const double slope = 4 * middle - 3 * start - end;
  const double ends = std::max(std::abs(start), std::abs(end));
  const bool vertex_inside = slope * bend < 0 && std::abs(slope) < 2 * std::abs(bend);
  return vertex_inside ? std::max(ends, std::abs(start - slope * slope / (4 * bend))) : ends;
}

// The slope a curve takes at a waypoint, from the slopes to its neighbours: pure functions of three waypoints.
// Inside: `before_s` and `after_s` are the time to the neighbours, `rise_*` the mean velocities on the way. This is
// Catmull-Rom with the times themselves as knots, so waypoints need not be evenly spaced: the curve through jittered
// samples of a motion is still that motion. Uniform knots are tens of times worse at 10 % jitter (curve_test.cpp).
inline double inner_tangent(double before_s, double rise_before, double after_s, double rise_after) LITHE_RT {
  return (after_s * rise_before + before_s * rise_after) / (before_s + after_s);
}

// At an end: the slope of the parabola through the end and its next two waypoints. `near` is the segment at the end.
inline double end_tangent(double near_s, double rise_near, double far_s, double rise_far) LITHE_RT {
  return ((2 * near_s + far_s) * rise_near - near_s * rise_far) / (near_s + far_s);
}

// The same two for joints that must never overshoot: weighted harmonic mean, and 0 where the motion turns round.
inline double inner_tangent_monotone(double before_s, double rise_before, double after_s, double rise_after) LITHE_RT {
  if (rise_before * rise_after <= 0) return 0;
  const double weight_before = 2 * after_s + before_s;
  const double weight_after = after_s + 2 * before_s;
  return (weight_before + weight_after) / (weight_before / rise_before + weight_after / rise_after);
}

inline double end_tangent_monotone(double near_s, double rise_near, double far_s, double rise_far) LITHE_RT {
  const double free = end_tangent(near_s, rise_near, far_s, rise_far);
  if (free * rise_near <= 0) return 0;
  return std::copysign(std::min(std::abs(free), 3 * std::abs(rise_near)), rise_near);
}

// Contract: RT · plain data; one thread
struct Knots {
  static constexpr std::size_t kMost = wire::kNw + 1;  // the waypoints, and the present motion before them

  std::array<std::int64_t, kMost> t_ns{};
  std::array<JointArray, kMost> rad{};
  std::array<JointArray, kMost> rad_s{};
  std::size_t count = 0;
  std::array<Arc, kMaxJoints> lead{};  // before the first knot, over the time since it

  void add(std::int64_t at_ns, const JointArray& position_rad, const JointArray& velocity_rad_s) LITHE_RT;
  void add(const wire::Plan& plan, std::size_t joints) LITHE_RT;  // velocities may be NaN until choose_velocities()

  // When all knots are there: a velocity for every one that has none, 0 at the end of a plan that is not continued,
  // else from the neighbours, never above the limit. The knots before `first` are over and keep theirs.
  void choose_velocities(const Limits& limits, const std::array<bool, kMaxJoints>& monotone, bool streaming,
                         std::size_t first) LITHE_RT;

  // The curve before a first knot that is near, from a motion at `now_rad_s`: the first arc, backwards, where that is
  // nearer to it in velocity, not faster than `most_rad_s` and at most twice as hard as the plan, as of a stream
  // whose plans begin ahead; else a constant velocity. (Positions are no measure: they differ while a blend lasts.)
  void choose_leads(std::int64_t now_ns, std::size_t joints, const JointArray& now_rad_s, const JointArray& most_rad_s)
      LITHE_RT;

  // The segment that holds at `now_ns`: from this knot to the next. 0 before the first knot.
  std::size_t segment_at(std::int64_t now_ns) const LITHE_RT;
  Arc arc(std::size_t knot, std::size_t j) const LITHE_RT;

  // A speed that each joint stays below from `now_ns` to the last knot. Cheap, and up to three times too high.
  void bound_speed(std::int64_t now_ns, std::size_t joints, JointArray& bound_rad_s) const LITHE_RT;
  // The highest speed of joint j on that way. Exact.
  double fastest(std::int64_t now_ns, std::size_t j) const LITHE_RT;
  // The same on one segment, from `from_s` after its first knot.
  double fastest_on(std::size_t knot, double from_s, std::size_t j) const LITHE_RT;

  // The largest acceleration of joint j on the segments from knot `first` on. Exact.
  double hardest(std::size_t first, std::size_t j) const LITHE_RT;

  // The highest speed of joint j from `from_s` (negative) to the first knot. Exact.
  double fastest_lead(double from_s, std::size_t j) const LITHE_RT {
    return peak(lead[j].velocity(from_s), lead[j].velocity(0.5 * from_s), lead[j].velocity(0));
  }

  double gap_s(std::size_t knot) const LITHE_RT { return static_cast<double>(t_ns[knot + 1] - t_ns[knot]) * 1e-9; }

 private:
  void measure(std::size_t joints) LITHE_RT;
  double velocity_from_neighbours(std::size_t knot, std::size_t j, bool monotone) const LITHE_RT;

  std::array<double, kMost> per_s_{};     // 1 / gap_s: a tick has no time for a division per joint and knot
  std::array<JointArray, kMost> rise_{};  // mean velocity to the next knot
};

}  // namespace lithe::plan
