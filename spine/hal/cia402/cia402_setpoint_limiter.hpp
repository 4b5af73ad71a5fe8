// SPDX-License-Identifier: Apache-2.0
// Computes a drive's setpoint from its joint's command, with limits.
#pragma once

#include <cstdint>

#include "spine/core/rt.hpp"
#include "spine/hal/cia402/cia402_setup.hpp"
#include "spine/hal/core/drive.hpp"

namespace lithe::hal::cia402 {

// In the units of its objects; two's complement in the lowest bytes.
struct RawSetpoint {
  std::uint32_t target = 0;  // 607Ah, 60FFh or 6071h, by its mode
  std::uint32_t torque = 0;  // 60B2h; of a torque drive 0
};

// The change from one setpoint to the next is bounded for any command:
//   torque     the PD loop of the command, closed on the last sample. From the moment the drive is on, the allowed
//   torque
//              grows from 0 by the joint's torque slew, or its soft start, whichever is slower: the command has grown
//              since the robot was armed, and drives take time to switch on.
//   position   at most the joint's largest velocity. To a target that jumped it accelerates and decelerates by the
//              joint's deceleration; without a target it comes to the target velocity in the same way. Towards a
//              position limit it is so slow that this deceleration stops it there; beyond one it goes inwards only.
//   velocity   stays below that velocity and changes by the joint's deceleration.
// Contract: RT but for the constructor · one thread · once per command of the drive
class SetpointLimiter {
 public:
  explicit SetpointLimiter(const DriverParams& params);

  // While the drive is off: resets the start of the next motion. Returns the setpoint that holds the present state.
  RawSetpoint rest(std::uint32_t position_raw) LITHE_RT;
  RawSetpoint next(const JointCommand& command, const JointSample& last) LITHE_RT;

 private:
  double closed_loop_nm(const JointCommand& command, const JointSample& last) const LITHE_RT;
  std::uint32_t torque_raw(double joint_nm, double limit_nm) const LITHE_RT;
  void move_position(const JointCommand& command) LITHE_RT;
  double step_to(double wanted, double reach) LITHE_RT;
  double before_limits(double step) const LITHE_RT;
  void move_velocity(const JointCommand& command) LITHE_RT;

  Mode mode_;
  JointTransform joint_;
  double counts_per_rev_;
  double rated_torque_nm_, torque_max_nm_;
  double counts_per_rad_;  // with the sign of the gear
  double period_s_;
  double step_counts_;                 // the longest of a position between two commands
  double least_counts_, most_counts_;  // of a position
  double slow_counts_;                 // by how much such a step shrinks, from one to the next
  double velocity_counts_s_, velocity_change_counts_s_;
  double torque_step_nm_;  // by which the allowed torque grows
  double share_step_;      // of the largest velocity

  double allowed_nm_ = 0;
  double share_ = 0;
  double at_counts_ = 0;  // position
  bool catches_up_ = false;
  double last_wanted_ = 0;
  double last_step_ = 0;    // and its last step
  double at_counts_s_ = 0;  // velocity
};

}  // namespace lithe::hal::cia402
