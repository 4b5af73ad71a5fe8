// SPDX-License-Identifier: Apache-2.0
// The slope a curve takes at a waypoint, from the slopes to its neighbours. Pure functions of three waypoints.
#pragma once

#include <algorithm>
#include <cmath>

#include "spine/core/rt.hpp"

namespace lithe::plan {

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

}  // namespace lithe::plan
