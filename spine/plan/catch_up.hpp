// SPDX-License-Identifier: Apache-2.0
// Moves a joint's setpoint to a plan that is too far away for a blend.
#pragma once

#include <algorithm>
#include <cmath>

#include "spine/core/rt.hpp"
#include "spine/plan/check.hpp"

namespace lithe::plan {

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
