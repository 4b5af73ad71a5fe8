// SPDX-License-Identifier: Apache-2.0
// Brings joints that are outside their position limits back inside: slowly, with little torque, inwards only.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string_view>

#include "spine/core/joints.hpp"
#include "spine/core/rt.hpp"
#include "spine/robot/config.hpp"

namespace lithe::guard {

// Runs in the mode recover instead of a law. It uses measured position and velocity only. Each joint has a goal: its
// position at the start, or the nearest one that is at least 0.02 rad inside the limits (less in a narrow range). A
// velocity controller follows a speed of at most recover_velocity_rad_s towards the goal; its integral term compensates
// the load; its gain is limited so that the loop stays stable with the joint's safe damping. The torque is at most
// recover_torque_share of torque_max_nm. Outside the limits
//   inward torque fades to zero between the recover speed and twice that speed, and
//   outward torque only brakes an inward motion: it is at most in proportion to the inward speed.
// Within the soft stop before a limit, torque towards that limit fades as for a law. Speed is bounded, not held: a
// joint that gravity pulls is faster for a moment, until the load is found. A load above the cap that pulls inwards is
// not held here; the guard's Envelope holds it, before the limit at the other end. A joint is stuck when it comes no
// nearer to its limits for kStallS plus the time in which the torque grows to its cap. It is also stuck when the
// recovery takes longer than three times the way at the recover speed, plus kPatienceS, plus that stall time.
// A drive that closes its own loop gets a target velocity instead, of that speed at most. From 90 % of the recover
// torque that the drive measures it is slower, and at the whole of it it stands: there the joint is stuck, too.
// Contract: RT after configure() · owned by the guard · bounded work per joint
class Recovery {
 public:
  // A joint that rests on its mechanical stop may be measured this far beyond its limit; it still counts as inside.
  static constexpr double kAtLimitRad = 0.01;
  static constexpr double kStallS = 2.0;
  static constexpr double kPatienceS = 10.0;

  void configure(const robot::RobotConfig& robot);

  // The next torque_nm() of every joint is the first of a recovery.
  void restart() LITHE_RT;

  // One tick of one joint. `now_nm`: the torque that it feels by the last output; the first tick starts from it. Not
  // yet slew-bounded; the guard does that.
  double torque_nm(std::size_t joint, double position_rad, double velocity_rad_s, double now_nm) LITHE_RT;

  // The same for a drive that closes its own loop: a velocity. `torque_nm`: as the drive measures it.
  double target_rad_s(std::size_t joint, double position_rad, double torque_nm) LITHE_RT;

  // True when a law may control the joint at this position.
  bool inside(std::size_t joint, double position_rad) const LITHE_RT;

  // Of the recovery that runs: it is inside its limits, with a margin.
  bool recovered(std::size_t joint) const LITHE_RT { return joint_[joint].state == State::inside; }
  // It ends: this joint cannot be brought inside its limits; why_stuck() says why.
  bool stuck(std::size_t joint) const LITHE_RT { return joint_[joint].state == State::stuck; }
  std::string_view why_stuck(std::size_t joint) const LITHE_RT;

  // Beyond which limit it began: 1 above, -1 below, 0 inside both.
  int from(std::size_t joint) const LITHE_RT { return joint_[joint].from; }

  double torque_cap_nm(std::size_t joint) const LITHE_RT { return joint_[joint].cap_nm; }
  double share() const LITHE_RT { return share_; }

 private:
  enum class State : std::uint8_t { fresh, moving, inside, stuck };

  struct Joint {
    double min_rad = 0, max_rad = 0;   // its limits
    double low_rad = 0, high_rad = 0;  // with the margin: where a goal may be
    double cap_nm = 0;                 // the most torque
    double kd_nm_s_rad = 0;            // of the velocity controller
    double ki_nm_rad = 0;              // of its integral part
    std::int64_t stall_ticks = 0;      // without progress, until it is stuck

    State state = State::fresh;
    int from = 0;
    double goal_rad = 0;
    double load_nm = 0;               // the integral part
    double least_beyond_rad = 0;      // the nearest to the limits that it has been
    std::int64_t ticks_at_least = 0;  // since then
    std::int64_t ticks_left = 0;      // of the whole recovery
  };

  void start(Joint& joint, double position_rad, double now_nm) LITHE_RT;
  void watch(Joint& joint, double position_rad) LITHE_RT;
  double permitted(const Joint& joint, double wanted_nm, double position_rad, double velocity_rad_s) const LITHE_RT;

  std::array<Joint, kMaxJoints> joint_{};
  std::size_t joints_ = 0;
  double dt_s_ = 0.001;
  double velocity_rad_s_ = 0.3;
  double share_ = 0.5;
  double soft_stop_per_rad_ = 10;
};

}  // namespace lithe::guard
