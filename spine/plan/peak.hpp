// SPDX-License-Identifier: Apache-2.0
// Maximum of a velocity that is a parabola over time. All velocities in this room are piecewise parabolas.
#pragma once

#include <algorithm>
#include <cmath>

#include "spine/core/rt.hpp"

namespace lithe::plan {

// The largest magnitude of the parabola through three values at the start, the middle and the end of an interval.
inline double peak(double start, double middle, double end) LITHE_RT {
  const double bend = 2 * (start - 2 * middle + end);  // over x = 0..1: start + slope x + bend x^2
  const double slope = 4 * middle - 3 * start - end;
  const double ends = std::max(std::abs(start), std::abs(end));
  const bool vertex_inside = slope * bend < 0 && std::abs(slope) < 2 * std::abs(bend);
  return vertex_inside ? std::max(ends, std::abs(start - slope * slope / (4 * bend))) : ends;
}

}  // namespace lithe::plan
