// SPDX-License-Identifier: Apache-2.0
// What runs when nothing else may: slow every joint down, then damp or hold it.
#pragma once

#include <cstddef>

#include "spine/core/joints.hpp"
#include "spine/core/rt.hpp"
#include "spine/robot/config.hpp"

namespace lithe::guard {

// It knows measured position and velocity and nothing else: no plan, no law, no parameters of either. From the speed
// at which it took over, each joint's reference slows down by deceleration_rad_s2 and stays inside the position
// limits; at rest it stays where it is (hold) or only damping is left (damp).
// Contract: RT after configure() · owned by the guard · bounded work per joint
class SafeLaw {
 public:
  void configure(const robot::RobotConfig& robot);

  // The next step() starts from the then measured state.
  void rearm() LITHE_RT { started_ = false; }

  // One tick. `usable[j]` false means joint j's sample is no basis for anything: its torque is 0, and the guard lets
  // the drive damp it. The torque is finite but not yet limited; the guard does that.
  void step(const JointArray& position_rad, const JointArray& velocity_rad_s,
            const std::array<bool, kMaxJoints>& usable, JointArray& torque_nm) LITHE_RT;

 private:
  struct Joint {
    double position_min_rad = 0, position_max_rad = 0, velocity_max_rad_s = 0;
    double slowing_rad_s = 0;  // taken from the reference's speed each tick
    double kp_nm_rad = 0, kd_nm_s_rad = 0;
    double reference_rad = 0, reference_rad_s = 0;
    bool tracking = false;  // false until a usable sample came
  };
  double torque(Joint& joint, double position_rad, double velocity_rad_s) const LITHE_RT;

  std::array<Joint, kMaxJoints> joint_{};
  std::size_t joints_ = 0;
  double dt_s_ = 0.001;
  bool hold_ = false;
  bool started_ = false;
};

}  // namespace lithe::guard
