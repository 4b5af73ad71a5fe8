// SPDX-License-Identifier: Apache-2.0
// The torque of a drive's own PD loop, and what "no target" is. There is no second formula.
#pragma once

#include <cmath>
#include <cstddef>
#include <limits>

#include "spine/core/joints.hpp"
#include "spine/core/rt.hpp"

namespace lithe {

// In place of a position target: there is none, and the stiffness does nothing. (A law knows it as kAbsent.)
inline constexpr double kNoTarget = std::numeric_limits<double>::quiet_NaN();
inline bool has_target(double target_rad) LITHE_RT { return !std::isnan(target_rad); }

// What one drive is told: a torque, and its own PD.
struct Pd {
  double torque_nm = 0;  // feed-forward
  double target_rad = kNoTarget;
  double target_rad_s = 0;
  double kp_nm_rad = 0;
  double kd_nm_s_rad = 0;

  // What the PD adds at this position and velocity [N m].
  double pd_nm(double position_rad, double velocity_rad_s) const LITHE_RT {
    const double spring_nm = has_target(target_rad) ? kp_nm_rad * (target_rad - position_rad) : 0.0;
    return spring_nm + kd_nm_s_rad * (target_rad_s - velocity_rad_s);
  }
  // The torque at the joint [N m].
  double felt_nm(double position_rad, double velocity_rad_s) const LITHE_RT {
    return torque_nm + pd_nm(position_rad, velocity_rad_s);
  }
};

// Joint j of a law's Effort, or of the commands to the drives.
template <class Joints>
Pd pd_of(const Joints& all, std::size_t j) LITHE_RT {
  return {all.torque_nm[j], all.position_rad[j], all.velocity_rad_s[j], all.kp_nm_rad[j], all.kd_nm_s_rad[j]};
}

// What every drive is told: the output of the guard, sent as it is.
struct JointCommands {
  JointArray torque_nm{};     // feed-forward
  JointArray position_rad{};  // of the drive's own PD loop; kNoTarget = none
  JointArray velocity_rad_s{};
  JointArray kp_nm_rad{};
  JointArray kd_nm_s_rad{};
  JointArray max_torque_nm{};  // torque limit of the drive itself

  void set(std::size_t j, const Pd& pd, double most_nm) LITHE_RT {
    torque_nm[j] = pd.torque_nm;
    position_rad[j] = pd.target_rad;
    velocity_rad_s[j] = pd.target_rad_s;
    kp_nm_rad[j] = pd.kp_nm_rad;
    kd_nm_s_rad[j] = pd.kd_nm_s_rad;
    max_torque_nm[j] = most_nm;
  }
};

}  // namespace lithe
