// SPDX-License-Identifier: Apache-2.0
// The safe law: slows every joint down, then damps or holds it.
#pragma once

#include <cstddef>

#include "spine/core/joints.hpp"
#include "spine/core/rt.hpp"
#include "spine/robot/config.hpp"

namespace lithe::guard {

// It uses measured position and velocity only: no plan, no law, no parameters. From the speed at which it took over,
// each joint's reference slows down by deceleration_rad_s2. Where that would not end before a position limit, it slows
// down faster, as far as torque, load and inertia allow. At rest it stays where it is (hold) or only damping is left
// (damp). A joint beyond a limit goes no farther and is not pulled back: that is what `recover` is for.
// Contract: RT after configure() · owned by the guard · bounded work per joint
class SafeLaw {
 public:
  void configure(const robot::RobotConfig& robot);

  // The joint's next torque() starts from the state measured then.
  void rearm(std::size_t joint) LITHE_RT { joint_[joint].tracking = false; }

  // One tick of one joint, from a usable sample. The result is finite but not limited; the guard does that.
  double torque_nm(std::size_t joint, double position_rad, double velocity_rad_s) LITHE_RT;

 private:
  struct Joint {
    double position_min_rad = 0, position_max_rad = 0, velocity_max_rad_s = 0;
    double slowing_rad_s2 = 0, most_rad_s2 = 0;  // of the reference
    double kp_nm_rad = 0, kd_nm_s_rad = 0;
    double low_rad = 0, high_rad = 0;  // the limits, or where the joint was beyond them
    double reference_rad = 0, reference_rad_s = 0;
    bool tracking = false;  // false until the first torque()
  };

  std::array<Joint, kMaxJoints> joint_{};
  double dt_s_ = 0.001;
  bool hold_ = false;
};

}  // namespace lithe::guard
