// SPDX-License-Identifier: Apache-2.0
// Blend from the present motion to a new plan: the difference decays to zero.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "spine/core/rt.hpp"
#include "spine/plan/knots.hpp"

namespace lithe::plan {

// One joint: s^2 (a + b s), s falling from 1 to 0 at per_s. Starts at a gap of position and velocity, ends with none.
struct Decay {
  double a = 0, b = 0, per_s = 1;

  static Decay over(double gap_rad, double gap_rad_s, double lasts_s) LITHE_RT {
    return {3 * gap_rad + lasts_s * gap_rad_s, -2 * gap_rad - lasts_s * gap_rad_s, 1 / lasts_s};
  }
  double left(double since_s) const LITHE_RT { return std::max(0.0, 1.0 - since_s * per_s); }
  double position(double s) const LITHE_RT { return s * s * (a + s * b); }
  double velocity(double s) const LITHE_RT { return -per_s * s * (2 * a + 3 * s * b); }
  // Never faster than this: as in Knots::bound_speed(), the corner and the end that is not 0.
  double bound_speed() const LITHE_RT { return per_s * std::max(std::abs(a), std::abs(2 * a + 3 * b)); }
  double acceleration(double s) const LITHE_RT { return s > 0 ? per_s * per_s * (2 * a + 6 * s * b) : 0.0; }
};

// The curve joint j follows from `now_ns` on, without any blend: before a first knot that is near, its own velocity
// backwards; then the arcs; behind the last knot a slowing down by `slowing_rad_s2`, and rest.
struct Course {
  const Knots& knots;
  std::int64_t now_ns;
  std::size_t j;
  double slowing_rad_s2;

  Arc start() const LITHE_RT;  // of the curve at now_ns; its u counts from there

  // The largest speed from now on until `decay`, laid on top, has faded. Exact: piece by piece a parabola.
  double fastest_under(const Decay& decay) const LITHE_RT;
};

}  // namespace lithe::plan
