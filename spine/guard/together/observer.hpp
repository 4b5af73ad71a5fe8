// SPDX-License-Identifier: Apache-2.0
// The state of all joints at the moment when the next commands act, by a model of the robot.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "spine/core/joints.hpp"
#include "spine/core/pd.hpp"
#include "spine/core/rt.hpp"
#include "spine/mechanics/tree.hpp"
#include "spine/robot/config.hpp"

namespace lithe::guard {

// A command as the drive carries it out.
struct Told : Pd {
  double most_nm = 0;         // the drive's torque limit
  double balance_rad_s = 0;   // the damping that a drive adds in any case acts around this speed
  double damping_nm_s_rad{};  // at least this much

  double torque_at(double position_rad, double tracked_rad_s) const LITHE_RT;
};

// Of every joint.
struct JointStates {
  JointArray position_rad{}, velocity_rad_s{};
  JointArray followed_rad_s{}, tracked_rad_s{};  // the two stages of the filter behind the drive's measured speed
  JointArray torque_nm{};                        // of the motor, after its lag
};

struct Seen {
  const JointArray& position_rad;
  const JointArray& velocity_rad_s;
  const std::array<bool, kMaxJoints>& fresh;  // this joint's values are measured, and finite
  double age_s;                               // of the sample, a whole number of ticks
};

// The commands that really acted are replayed through the model from the time of each sample on: motor lag, the drive's
// velocity filter, its own PD and damping, drives that are asked in every Nth tick, samples that are late.
// A joint without a measurement for kLongestUnseenS is assumed to rest where it was seen last.
// Contract: RT after configure() · owned by the guard · bounded work
class Observer {
 public:
  static constexpr double kLongestUnseenS = 0.1;

  void configure(const robot::RobotConfig& robot);
  // The drives are off: starts from the next sample.
  void forget() LITHE_RT;
  // The commands of the last tick were sent. Counts, also while the drives are off, which drives were asked.
  void dispatched() LITHE_RT {
    was_sent_ = true;
    ++exchanges_;
  }

  // Once a tick.
  void observe(const Seen& seen) LITHE_RT;
  // The output of this tick.
  void command(std::size_t joint, const Pd& pd, double most_nm) LITHE_RT;

  // When the next commands come to the drives, and when their torque acts.
  const JointStates& next() const LITHE_RT { return next_; }
  const JointStates& then() const LITHE_RT { return then_; }
  // Of the command that acts, at next(), before the motor's lag.
  double felt_nm(std::size_t joint) const LITHE_RT { return felt_nm_[joint]; }
  // The drive is asked in the next exchange.
  bool asked(std::size_t joint) const LITHE_RT { return exchanges_ % joint_[joint].divider == 0; }
  double ahead_s() const LITHE_RT { return ahead_s_; }  // from the sample to then(), with the filter's delay
  double hold_s() const LITHE_RT { return hold_s_; }    // until all drives have been asked again

  // At then().
  const mechanics::Square& mass_kg_m2() const LITHE_RT { return mass_; }
  const mechanics::Square& inverse_mass() const LITHE_RT { return inverse_; }
  const JointArray& bias_nm() const LITHE_RT { return bias_; }
  mechanics::Tree& tree() LITHE_RT { return tree_; }

 private:
  static constexpr std::size_t kPast = 64;  // ticks; an older sample corrects nothing
  struct Joint {
    unsigned divider = 1;
    bool computed_here = false;  // our driver closes the PD loop, once in an exchange
    double lag_share = 1, filter_share = 1, damping_nm_s_rad = 0, most_rad_s = 0;
    double coulomb_nm = 0, slow_rad_s = 1;  // dry friction, and the speed at which half of it acts
  };
  struct Tick {
    std::array<Told, kMaxJoints> acting{};
    std::array<bool, kMaxJoints> asked{};
    JointStates at;
  };

  double bounded(std::size_t j, double rad_s) const LITHE_RT;
  double friction_nm(std::size_t j, double rad_s) const LITHE_RT;
  void start(const Seen& seen) LITHE_RT;
  void take_over(const Seen& seen, Tick& tick) LITHE_RT;
  void correct(const Seen& seen, Tick& then) LITHE_RT;
  void rest_unseen(const Seen& seen, JointStates& at) LITHE_RT;
  void look_ahead(const Seen& seen) LITHE_RT;
  void evaluate(const JointStates& at) LITHE_RT;
  void step(JointStates& at, const std::array<Told, kMaxJoints>& acting, unsigned steps) LITHE_RT;
  void advance(JointStates& at, const std::array<Told, kMaxJoints>& acting) LITHE_RT;
  Tick& past(std::uint64_t tick) LITHE_RT { return past_[tick % kPast]; }

  mechanics::Tree tree_;
  std::array<Joint, kMaxJoints> joint_{};
  double period_s_ = 1e-3, step_s_ = 2.5e-4, lag_s_ = 0, filter_s_ = 0;
  unsigned steps_per_tick_ = 4, steps_per_block_ = 4, steps_of_lag_ = 4;
  bool was_sent_ = false, started_ = false;
  std::uint64_t now_ = 0, corrected_ = 0, exchanges_ = 0;
  std::array<Tick, kPast> past_{};
  std::array<Told, kMaxJoints> acting_{}, given_{};
  JointArray last_rad_s_{}, last_rad_{}, unseen_s_{};
  JointStates next_, then_;
  JointArray felt_nm_{}, bias_{};
  mechanics::Square mass_{}, lower_{}, inverse_{};
  double ahead_s_ = 0, hold_s_ = 1e-3;
};

}  // namespace lithe::guard
