// SPDX-License-Identifier: Apache-2.0
// Keeps one joint inside its position and velocity limits: selects a torque after which the joint can still be stopped.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "spine/core/rt.hpp"
#include "spine/robot/config.hpp"
#include "spine/robot/limits/stopping.hpp"

namespace lithe::guard {

// A joint as it was measured, or is predicted.
struct Measured {
  double position_rad = 0;
  double velocity_rad_s = 0;
  double age_s = 0;             // of both
  std::uint32_t age_ticks = 0;  // ticks since the one that had them new
};

// Selects a torque in the range that the slew bound allows:
// 1. The torque nearest to the wanted one with which the joint still stops before its position limits and stays below
//    its velocity limit.
// 2. "Still stops" assumes the worst: the largest load pushes outwards from now on; since the sample, and until the new
//    torque acts, it is the worst of those that were in flight; the new one acts until the next one; then the torque
//    falls to full braking at the slew bound (robot/limits/stopping.hpp).
// 3. If no torque stops the joint: the one that brakes hardest. If that would carry the joint to the opposite limit:
//    the torque with the same overrun at both limits.
// 4. Beyond a limit: a torque with which the joint goes no farther, and comes back slowly.
// 5. In flight are also what the drive adds by itself: its PD between two commands, and its lag.
// Contract: RT after configure() · one thread · bounded work
class Envelope {
 public:
  void configure(const robot::RobotConfig& robot, const robot::JointConfig& joint);

  // False when load and inertia are not known.
  bool on() const LITHE_RT { return brakes_.inertia_max_kg_m2 > 0; }

  // To be called when the drive is off.
  void forget() LITHE_RT;

  // Once per tick: the range of torque that the last dispatched command can cause [N m].
  void in_flight(double least_nm, double most_nm) LITHE_RT;

  // How far the drive's own PD may move the torque away from `torque_nm`, down and up, before the next command acts
  // [N m].
  struct Drift {
    double down_nm = 0, up_nm = 0;
  };
  Drift drift(const Measured& now, double torque_nm, double kp_nm_rad, double kd_nm_s_rad) const LITHE_RT;

  // least_nm <= wanted_nm <= most_nm.
  double bound(const Measured& now, double least_nm, double wanted_nm, double most_nm) const LITHE_RT;
  // The same for one limit only, when the joint is beyond the other one or comes from there.
  double bound_one(const Measured& now, double least_nm, double wanted_nm, double most_nm, bool up) const LITHE_RT;

  // Uncertainty of the joint's state when the next command takes effect.
  double unknown_rad(double ahead_s) const LITHE_RT { return 0.5 * ahead_s * unknown_rad_s(ahead_s); }
  double unknown_rad_s(double ahead_s) const LITHE_RT {
    return on() ? (brakes_.torque_max_nm + brakes_.load_nm) / brakes_.inertia_min_kg_m2 * ahead_s : 0;
  }

 private:
  static constexpr std::size_t kBuckets = 8;
  struct Range {
    double least_nm = 0, most_nm = 0;
  };

  robot::Stop stop(const Measured& now, const Range& flying, double torque_nm, bool up) const LITHE_RT;
  double way_left_rad(const Measured& now, bool up) const LITHE_RT;
  bool stops(const Measured& now, const Range& flying, double torque_nm, bool up) const LITHE_RT;
  double restrict(const Measured& now, const Range& flying, double far_nm, double torque_nm, bool up) const LITHE_RT;
  double balance(const Measured& now, const Range& flying, double least_nm, double most_nm) const LITHE_RT;
  // Of all torques that acted since a sample of this age, or will.
  Range flying(std::uint32_t age_ticks) const LITHE_RT;

  robot::Brakes brakes_;
  double position_min_rad_ = 0, position_max_rad_ = 0, speed_max_rad_s_ = 0;
  double reaction_s_ = 0, period_s_ = 0;
  double damping_nm_s_rad_ = 0;  // that a drive adds to every command
  // What was in flight lately, in buckets of one or more ticks; the newest is past_[bucket_].
  std::array<Range, kBuckets> past_{};
  std::size_t bucket_ = 0, ticks_left_ = 0, ticks_per_bucket_ = 1;  // ticks_left_: of the newest
  std::size_t acts_for_ticks_ = 0;                                  // a torque, after it was sent
};

}  // namespace lithe::guard
