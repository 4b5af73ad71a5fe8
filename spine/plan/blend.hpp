// SPDX-License-Identifier: Apache-2.0
// From the present motion to a new plan: a blend, in which the difference decays to zero, or, where the plan is too far
// away for that, catching up.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "spine/core/rt.hpp"
#include "spine/plan/check.hpp"
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

// The curve joint j follows from `now_ns` on, without any blend: before a first knot that is near, its lead; then
// the arcs; behind the last knot a slowing down by `slowing_rad_s2`, and rest.
struct Course {
  const Knots& knots;
  std::int64_t now_ns;
  std::size_t j;
  double slowing_rad_s2;

  Arc start() const LITHE_RT;  // of the curve at now_ns; its u counts from there

  // The largest speed from now on until `decay`, laid on top, has faded. Exact: piece by piece a parabola.
  double fastest_under(const Decay& decay) const LITHE_RT;
};

// One joint on its way to a moving goal. Every step accelerates by at most most_rad_s2, never beyond the velocity
// limit, and never so fast that half of most_rad_s2 could not stop it before a position limit. Towards the goal it is
// as fast as half of most_rad_s2 can take back in the way that is left; the other half is for the goal's own
// acceleration, so the setpoint arrives whenever that is no larger.
// Contract: RT · a value · one thread
struct CatchUp {
  bool on = false;
  double position_rad = 0, velocity_rad_s = 0, acceleration_rad_s2 = 0;
  double most_rad_s2 = 0;

  void step(double goal_rad, double goal_rad_s, double dt_s, const JointLimits& limits) LITHE_RT {
    // Both where they were a step ago.
    const double gap_rad = goal_rad - goal_rad_s * dt_s - position_rad;
    const double wanted = goal_rad_s + std::copysign(stoppable(std::abs(gap_rad), dt_s), gap_rad);
    const double up = std::min(limits.velocity_max_rad_s, stoppable(limits.position_max_rad - position_rad, dt_s));
    const double down = std::min(limits.velocity_max_rad_s, stoppable(position_rad - limits.position_min_rad, dt_s));
    const double change = std::clamp(wanted, -down, up) - velocity_rad_s;
    acceleration_rad_s2 = std::clamp(change / dt_s, -most_rad_s2, most_rad_s2);
    const double before_rad_s = velocity_rad_s;
    velocity_rad_s += acceleration_rad_s2 * dt_s;
    position_rad += 0.5 * (before_rad_s + velocity_rad_s) * dt_s;
    position_rad = std::clamp(position_rad, limits.position_min_rad, limits.position_max_rad);
  }

 private:
  // The speed that half of most_rad_s2 takes away over this way; a way shorter than a step's is gone in one.
  double stoppable(double way_rad, double dt_s) const LITHE_RT {
    const double way = std::max(way_rad, 0.0);
    return std::min(std::sqrt(most_rad_s2 * way), way / dt_s);
  }
};

}  // namespace lithe::plan
