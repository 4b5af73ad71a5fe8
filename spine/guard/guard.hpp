// SPDX-License-Identifier: Apache-2.0
// The guard: checks and limits every command to the motors. It trusts no law, no Brain and no sensor.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>

#include "lithe/law.hpp"
#include "spine/core/joints.hpp"
#include "spine/core/pd.hpp"
#include "spine/core/rt.hpp"
#include "spine/guard/envelope.hpp"
#include "spine/guard/recovery.hpp"
#include "spine/guard/safe_law.hpp"
#include "spine/guard/together/coordinated.hpp"
#include "spine/robot/config.hpp"
#include "spine/robot/limits/drive_loop.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::guard {

struct Input {
  wire::Mode mode;
  std::uint32_t stale_ticks;  // ticks in a row without a new sample; 0 = fresh
  std::int64_t brain_age_ns;  // since the Brain's last heartbeat; negative = none so far
  const JointArray& position_rad;
  const JointArray& velocity_rad_s;
  const std::array<std::uint32_t, kMaxJoints>& joint_status;  // bits of wire::joint_status
  const Effort& effort;                                       // what the law wants
  std::int64_t sample_age_ns = 0;                             // of position and velocity
  const JointArray* torque_nm = nullptr;                      // as the drives measure it; only `recover` uses it
};

// The ladder of a stopped group, from the mildest rung to the last. A group brakes, and is later switched off, after
// its own time at rest (brake_after_s, off_after_s). Only `reset` or `recover` leads back up.
using wire::Rung;

struct Verdict {
  wire::Fault fault = wire::Fault::none;  // the worst fault; the loop must latch it
  std::uint32_t flags = 0;                // bits of wire::telemetry_flag
  std::uint32_t law_flags = 0;            // those of them that are caused by the law's output
  bool use_safe_law = false;              // the safe law controls all joints
  bool recovering = false;                // this tick was one of the mode recover
  bool recovered = false;                 // and every joint is inside its limits now
};

// Joints that stop together.
struct Group {
  wire::Fault fault = wire::Fault::none;  // latched
  std::uint8_t joint = 0;                 // the joint with the fault
  bool news = false;                      // it stopped in this tick
  Rung rung = Rung::law;
  std::uint64_t ticks_at_rest = 0, ticks_seen_at_rest = 0;
};

// In the order of authority: not finite, drives, freshness and overrun -> safe law, in the same tick. Then per joint,
// in this order: torque, power, soft stop and velocity, slew, and last the torque that still stops before the limits
// (Envelope). A fault of one joint stops the joint's group; the other groups continue under the law or stop too, as the
// robot file says (`other_groups`). A fault that belongs to no single joint stops all joints.
//
// Slew: when a command replaces the one before it, the torque at the joint changes by at most torque_slew_nm_s /
// rate_hz. This torque is the feed-forward plus the drive's own PD, at the position that the guard predicts for that
// moment. This holds for a law, the next law of a swap, and the safe law. A drive that is asked in every Nth tick gets
// N such steps at once. The prediction has errors: under adversarial laws the simulated joint had larger steps
// (tests/limits), up to 2.1 (arm), 2.0 (frankenstein) and 4 times (chain; 6 times if every drive is asked in every tick
// at 4 to 10 kHz), and in the rarest of 20,000 further runs 2.9, 2.3 and 6.8 times. Disarming and e-stop have no slew.
//
// With a [model] in the robot file, the last step is one for all joints (Coordinated), at the state that its Observer
// predicts; the fading before a limit and Envelope are for robots without one.
//
// A joint without a usable sample is braked by its drive, which knows its own velocity. The feed-forward fades, then
// damping grows to safe_kd_nm_s_rad. Both are within the slew bound up to the speed that is a fault.
// A drive that closes its own velocity or position loop (robot/limits/drive_loop.hpp) gets no torque from the guard:
// the safe law is "no target", with which its driver slows it down by deceleration_rad_s2 and holds it where it is,
// also beyond a limit and with safe_end = "damp"; `recover` gives it a target velocity. A law's feed-forward stays an
// offset, and a target speed is one from which the joint stops before its limit.
// Contract: RT after configure() · owned by the tick thread · bounded work per joint
class Guard {
 public:
  static constexpr double kAtRestRadS = 0.05;  // a slower joint is at rest

  void configure(const robot::RobotConfig& robot);

  // Call at arming, when the drives are off: the slew bound starts at 0. Also rearms the safe law.
  void reset_output() LITHE_RT;

  // `reset`: clears all latched faults.
  void forget_faults() LITHE_RT;

  // The last output was sent: the next slew bound starts from it. An output that was not sent is ignored.
  void dispatched() LITHE_RT;

  // In mode recover, whatever the proposal, every joint is brought inside its limits (recovery.hpp). Every joint fault
  // of mode active is a fault here too, except position_limit; a fault of any joint stops all joints.
  // `out`: always finite (position kNoTarget = none) and within the limits, for any input.
  Verdict check(const Input& in, JointCommands& out) LITHE_RT;
  // Of this joint in the last check; at brake and off its command is not used.
  Rung rung(std::size_t joint) const LITHE_RT { return joint_[joint].rung; }

  // Call before the mode recover begins.
  void start_recovery() LITHE_RT;
  const Recovery& recovery() const LITHE_RT { return recovery_; }

  // Expected torque at the joint by the last output.
  double expected_torque_nm(std::size_t joint) const LITHE_RT { return joint_[joint].last.decided_nm; }

  // In order of their first use in the robot file.
  std::span<const Group> groups() const LITHE_RT { return {group_.data(), groups_}; }
  bool any_stopped() const LITHE_RT { return any_stopped_; }
  bool stopped(std::size_t joint) const LITHE_RT { return group_[joint_[joint].group].fault != wire::Fault::none; }
  // The first joint for which a law's output is not finite; kMaxJoints = none. Stopped joints are ignored.
  std::size_t not_finite_at(const Effort& effort) const LITHE_RT;
  // Bits of wire::telemetry_flag: what the law's output made the guard do at this joint in the last check.
  std::uint32_t law_flags(std::size_t joint) const LITHE_RT { return joint_[joint].law_flags; }
  // The first fault of this joint since the last reset.
  wire::Fault joint_fault(std::size_t joint) const LITHE_RT { return joint_[joint].fault; }

 private:
  struct Limits {
    double position_min_rad, position_max_rad;
    double soft_stop_per_rad;  // 1 / width of the fading zone
    double overrun_rad;
    double velocity_max_rad_s, velocity_fault_rad_s, velocity_fade_s_rad;
    double torque_max_nm, slew_nm;  // slew per tick
    double power_max_w;             // infinity = no limit
    double kp_max_nm_rad, kd_max_nm_s_rad;
    double blind_kd_nm_s_rad, blind_kd_step_nm_s_rad;  // damping of an unusable joint, and its growth per tick
    double deceleration_rad_s2;
    robot::DriveLoop loop;
    bool must_be_homed;
  };
  // For a joint without a usable sample, whose torque is unknown, only its damping is used.
  struct Command : Pd {
    double decided_nm = 0;             // the intended torque at the joint
    double least_nm = 0, most_nm = 0;  // its range until another command acts
    double blind_kd_nm_s_rad = 0;      // damping without a usable sample

    double pd_nm(const Measured& at) const LITHE_RT { return Pd::pd_nm(at.position_rad, at.velocity_rad_s); }
    double felt_nm(const Measured& at) const LITHE_RT { return Pd::felt_nm(at.position_rad, at.velocity_rad_s); }
  };
  struct Joint {
    Limits limit{};
    Envelope envelope;
    std::uint32_t law_flags = 0;
    bool at_envelope = false;        // in the last tick the envelope changed the law's torque
    bool usable = false;             // the sample of this tick
    std::uint32_t unseen_ticks = 0;  // in a row in which the bus was in time and the drive's answer is missing
    Command last, sent;              // by the last output, and by the last one that was dispatched
    wire::Fault fault = wire::Fault::none;
    Rung rung = Rung::law;
    std::uint8_t group = 0;
  };
  // Of the whole robot, from its file.
  struct Rules {
    std::uint32_t late_ticks_to_stop = 20;
    std::int64_t brain_stale_ns = 0;
    bool stop_when_brain_stale = false;
    double soft_start_step = 1;
    std::uint64_t brake_after_ticks = 0, off_after_ticks = 0;  // at rest in the safe stop; 0 = never
    bool others_go_on = false;
  };
  // Torques that the slew bound allows, around what the joint feels when the new command takes over.
  struct Reach {
    double now_nm, least_nm, most_nm;
  };

  // What a joint shall do, before the torques of all are bounded together.
  struct Proposal {
    Command command{};
    double most_nm = 0, wanted_nm = 0;
  };

  void configure_groups(const robot::RobotConfig& robot);

  // faults.cpp
  wire::Fault find_fault(const Input& in, Verdict& verdict) LITHE_RT;
  wire::Fault fault_of_joints(const Input& in, bool too_late) LITHE_RT;
  wire::Fault fault_of_joint(const Input& in, std::size_t j) const LITHE_RT;
  wire::Fault fault_of_robot(const Input& in, bool too_late, std::uint32_t& flags) const LITHE_RT;
  void latch(const Joint& joint, std::size_t j, wire::Fault fault) LITHE_RT;
  void descend(Group& group, bool at_rest, bool seen_at_rest) LITHE_RT;
  void descend_all(const Input& in, bool all) LITHE_RT;

  // coupled.cpp
  void observe(const Input& in) LITHE_RT;
  void decide_together(const Input& in, JointCommands& out, Verdict& verdict) LITHE_RT;
  Proposal propose_law(std::size_t j, const Input& in) LITHE_RT;
  Proposal propose_safe_law(std::size_t j) LITHE_RT;
  void tell_observer(const JointCommands& out) LITHE_RT;
  void choose(std::size_t j, const Proposal& proposal, Choice& choice, JointArray& torque_nm, std::uint32_t& flags)
      LITHE_RT;
  void settle_torque(std::size_t j, const Input& in, Command command, double torque_nm, double most_nm,
                     JointCommands& out) LITHE_RT;

  void apply_law(std::size_t j, const Input& in, JointCommands& out, std::uint32_t& flags) LITHE_RT;
  void apply_safe_law(std::size_t j, const Input& in, JointCommands& out, std::uint32_t& flags) LITHE_RT;
  void brake_blindly(std::size_t j, JointCommands& out, std::uint32_t& flags) LITHE_RT;
  void recover(const Input& in, JointCommands& out, Verdict& verdict) LITHE_RT;
  void recover_by_target(std::size_t j, const Input& in, JointCommands& out) LITHE_RT;
  void switch_off(std::size_t j, JointCommands& out) LITHE_RT;

  Measured measured(std::size_t j, const Input& in) const LITHE_RT;
  Measured ahead(const Measured& now) const LITHE_RT;
  Reach reach(const Joint& joint, const Measured& now, double step_nm) const LITHE_RT;
  double settle_gains(const Joint& joint, const Measured& now, Command& command) const LITHE_RT;
  // The torque nearest to `wanted_nm` within limits and slew.
  double bound(Joint& joint, double wanted_nm, const Measured& now, double torque_max_nm, double step_nm,
               std::uint32_t& flags) const LITHE_RT;
  void remember(Joint& joint, const Measured& now, Command command) const LITHE_RT;

  Rules rules_;
  std::size_t joints_ = 0;
  double period_s_ = 0.001;
  std::array<Joint, kMaxJoints> joint_{};
  std::size_t groups_ = 0;
  std::array<Group, kMaxJoints> group_{};
  bool any_stopped_ = false;  // a group, latched
  double soft_start_ = 1;     // share of the torque limits that a law may use
  SafeLaw safe_law_;
  Recovery recovery_;
  std::unique_ptr<Coordinated> together_;  // null without a model; too large for a stack
};

}  // namespace lithe::guard
