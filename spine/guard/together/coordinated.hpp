// SPDX-License-Identifier: Apache-2.0
// Keeps all joints of a robot inside their limits together, by a model of the robot.
#pragma once

#include <array>
#include <cstddef>

#include "spine/core/joints.hpp"
#include "spine/core/rt.hpp"
#include "spine/guard/together/observer.hpp"
#include "spine/robot/config.hpp"

namespace lithe::guard {

// The torques that the slew bound and the drives allow when the next commands act, and what is wanted of them [N m].
struct Choice {
  JointArray least_nm{}, most_nm{};        // equal: this joint's torque is not to be chosen
  std::array<bool, kMaxJoints> ignored{};  // its limits are not kept: nothing here can move it
};

// Selects the torques nearest to the wanted ones with which all joints can still be stopped together:
// 1. Brake: each joint slows down with the deceleration allotted to it (robot/limits/model.hpp), all torques change
//    along one line as fast as the slew bound lets the slowest. A joint that this does not stop brakes at its own slew.
// 2. Each joint's acceleration is reduced until its own deceleration still stops it: a joint that leans on its limit
//    does not hold the others. The allotted one is for the worst case; counted on is what all torques permit in this
//    pose and for these directions, between one and three times as much.
// 3. Line search between brake and what 2 left: the largest share of it with which every joint stops before its
//    position limits, below its velocity limit, with torques within torque_max_nm at kPoints of the way.
// Accelerations may be wrong by [model] error; the argument and its assumptions are in docs/adr/0026.
// Contract: RT after configure() · owned by the guard · bounded work: O(joints^2), at most 7 evaluations of a stop
class Coordinated {
 public:
  void configure(const robot::RobotConfig& robot);
  Observer& observer() LITHE_RT { return observer_; }
  const Observer& observer() const LITHE_RT { return observer_; }

  double slew_step_nm(std::size_t joint) const LITHE_RT { return joint_[joint].slew_step_nm; }
  double kp_most_nm_rad(std::size_t joint) const LITHE_RT { return joint_[joint].kp_most_nm_rad; }
  double kd_most_nm_s_rad(std::size_t joint) const LITHE_RT { return joint_[joint].kd_most_nm_s_rad; }

  // After observe(). `torque_nm`: wanted, within the choice; then the torques to apply.
  void bound(const Choice& choice, JointArray& torque_nm) LITHE_RT;

 private:
  static constexpr int kPoints = 3;
  static constexpr int kHalvings = 5;

  struct Joint {
    double min_rad = 0, max_rad = 0, speed_rad_s = 0, torque_nm = 0, slew_nm_s = 0, slew_step_nm = 0,
           allotted_rad_s2 = 1;
    double kp_most_nm_rad = 0, kd_most_nm_s_rad = 0;
  };
  struct Brake {
    JointArray wanted_nm{}, torque_nm{}, rad_s2{};
  };
  using Sides = std::array<std::array<bool, 2>, kMaxJoints>;  // down, up

  void allot_now() LITHE_RT;
  void prepare(const Choice& choice) LITHE_RT;
  bool all_stop(const JointArray& torque_nm) LITHE_RT;
  bool torques_reach(const JointArray& position_rad, const JointArray& velocity_rad_s, const JointArray& brake_rad_s2)
      LITHE_RT;
  bool stops(std::size_t j, bool up, double rad_s2, double transition_s, double unsure_rad_s2) const LITHE_RT;
  bool stops(std::size_t j, bool up, double rad_s2, double transition_s) const LITHE_RT;
  bool may_wait(std::size_t j, bool up, double torque_nm, double rad_s2) const LITHE_RT;
  double brake_rad_s2(std::size_t j, double q, double v, double share, double hardest) const LITHE_RT;
  double way_left_rad(std::size_t j, bool up) const LITHE_RT;
  double slow_rad_s(std::size_t j, bool up) const LITHE_RT;
  double transition_s(const JointArray& torque_nm, const JointArray& rad_s2, JointArray& brake) const LITHE_RT;
  JointArray acceleration(const JointArray& torque_nm) const LITHE_RT;
  void choose_brake() LITHE_RT;
  void plan(const JointArray& rad_s2, const JointArray& extra_rad_s2) LITHE_RT;
  bool harden(const JointArray& rad_s2, JointArray& extra_rad_s2, std::array<bool, kMaxJoints>& hard) const LITHE_RT;
  bool restrict_each(JointArray& torque_nm) LITHE_RT;
  double restricted(std::size_t j, bool up, double rad_s2, double transition_s) const LITHE_RT;

  Observer observer_;
  std::size_t joints_ = 0;
  std::array<Joint, kMaxJoints> joint_{};
  double error_ = 0;
  // Of this tick.
  Choice choice_;
  JointArray unsure_rad_s_{}, now_rad_s2_{};  // now: the deceleration that a stop counts on
  Brake brake_;
  Sides beyond_brake_{};  // limits before which not even the brake stops
};

}  // namespace lithe::guard
