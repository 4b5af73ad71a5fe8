// SPDX-License-Identifier: Apache-2.0
#include "spine/guard/guard.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace lithe::guard {
namespace {

using wire::Fault;
using wire::Mode;
namespace flag = wire::telemetry_flag;

double reciprocal(double width) { return 1.0 / std::max(width, 1.0e-9); }

// The largest speed from which `deceleration_rad_s2` stops on this way, with a fifth of it to spare.
double speed_that_stops(double way_rad, double deceleration_rad_s2) LITHE_RT {
  constexpr double kShare = 0.8;
  return std::sqrt(2 * kShare * deceleration_rad_s2 * std::max(way_rad, 0.0));
}

// 1 where there is room, 0 where there is none, linear in between.
double room(double distance, double per_width) LITHE_RT { return std::clamp(distance * per_width, 0.0, 1.0); }

}  // namespace

void Guard::configure(const robot::RobotConfig& robot) {
  joints_ = std::min(robot.joints.size(), kMaxJoints);
  period_s_ = 1.0 / robot.rate_hz;
  const auto ticks_of = [&robot](double time_s) {
    return static_cast<std::uint64_t>(std::ceil(time_s * robot.rate_hz));
  };
  rules_ = {.late_ticks_to_stop = robot.spine.late_ticks_to_stop,
            .brain_stale_ns = static_cast<std::int64_t>(robot.brain.stale_after_s * 1.0e9),
            .stop_when_brain_stale = robot.brain.on_stale == robot::StaleAction::safe_stop,
            .soft_start_step = 1.0 / std::max(robot.guard.soft_start_s * robot.rate_hz, 1.0),
            .brake_after_ticks = ticks_of(robot.guard.brake_after_s),
            .off_after_ticks = ticks_of(robot.guard.off_after_s),
            .others_go_on = robot.guard.other_groups == robot::OtherGroups::go_on};
  for (std::size_t j = 0; j < joints_; ++j) {
    const robot::JointConfig& joint = robot.joints[j];
    const double fault_rad_s = joint.velocity_max_rad_s * robot.guard.velocity_overrun;
    const robot::DriveLoop loop = robot::loop_of(robot, joint);
    const bool by_torque = loop == robot::DriveLoop::torque;  // else the drive has gains of its own
    joint_[j].limit =
        Limits{.position_min_rad = joint.position_min_rad,
               .position_max_rad = joint.position_max_rad,
               .soft_stop_per_rad = reciprocal(robot.guard.soft_stop_rad),
               .overrun_rad = robot.guard.position_overrun_rad,
               .velocity_max_rad_s = joint.velocity_max_rad_s,
               .velocity_fault_rad_s = fault_rad_s,
               .velocity_fade_s_rad = reciprocal(fault_rad_s - joint.velocity_max_rad_s),
               .torque_max_nm = joint.torque_max_nm,
               .slew_nm = joint.torque_slew_nm_s / robot.rate_hz,
               .power_max_w = joint.power_max_w > 0 ? joint.power_max_w : std::numeric_limits<double>::infinity(),
               .kp_max_nm_rad = by_torque ? joint.kp_max_nm_rad : 0.0,
               .kd_max_nm_s_rad = by_torque ? joint.kd_max_nm_s_rad : 0.0,
               .blind_kd_nm_s_rad = joint.safe_kd_nm_s_rad,
               .blind_kd_step_nm_s_rad = joint.torque_slew_nm_s / robot.rate_hz / fault_rad_s,
               .deceleration_rad_s2 = joint.deceleration_rad_s2,
               .loop = loop,
               .must_be_homed = joint.must_be_homed};
    joint_[j].envelope = {};
    if (by_torque) joint_[j].envelope.configure(robot, joint);
  }
  configure_groups(robot);
  safe_law_.configure(robot);
  recovery_.configure(robot);
  together_.reset();
  if (robot.model.given) {
    together_ = std::make_unique<Coordinated>();
    together_->configure(robot);
  }
  reset_output();
}

void Guard::configure_groups(const robot::RobotConfig& robot) {
  groups_ = 0;
  for (std::size_t j = 0; j < joints_; ++j) {
    const auto first = std::find_if(robot.joints.begin(), robot.joints.end(), [&](const robot::JointConfig& joint) {
      return joint.group == robot.joints[j].group;
    });
    const auto leader = static_cast<std::size_t>(first - robot.joints.begin());
    joint_[j].group = leader < j ? joint_[leader].group : static_cast<std::uint8_t>(groups_++);
  }
  forget_faults();
}

void Guard::reset_output() LITHE_RT {
  soft_start_ = 0;
  for (Group& group : group_) {
    group.ticks_at_rest = group.ticks_seen_at_rest = 0;
    group.rung = Rung::law;
  }
  for (std::size_t j = 0; j < joints_; ++j) {
    Joint& joint = joint_[j];
    joint.last = joint.sent = {};
    joint.at_envelope = false;
    joint.envelope.forget();
    safe_law_.rearm(j);
  }
  if (together_ != nullptr) together_->observer().forget();
}

void Guard::dispatched() LITHE_RT {
  if (together_ != nullptr) together_->observer().dispatched();
  for (std::size_t j = 0; j < joints_; ++j) joint_[j].sent = joint_[j].last;
}

Verdict Guard::check(const Input& in, JointCommands& out) LITHE_RT {
  Verdict verdict;
  const Fault fault = find_fault(in, verdict);
  const bool driven =
      in.mode == Mode::active || in.mode == Mode::hold || in.mode == Mode::safe_stop || in.mode == Mode::recover;
  if (!driven) {
    for (std::size_t j = 0; j < joints_; ++j) {
      switch_off(j, out);
      joint_[j].rung = in.mode == Mode::estop ? group_[joint_[j].group].rung : Rung::law;
    }
    return {.flags = verdict.flags};
  }
  for (std::size_t j = 0; j < joints_; ++j)
    joint_[j].envelope.in_flight(joint_[j].sent.least_nm, joint_[j].sent.most_nm);
  verdict.fault = fault;
  verdict.recovering = in.mode == Mode::recover;
  descend_all(in, verdict.use_safe_law);
  if (together_ != nullptr) observe(in);
  if (verdict.recovering && !verdict.use_safe_law) {
    recover(in, out, verdict);
    tell_observer(out);
    return verdict;
  }
  if (!verdict.use_safe_law) {
    soft_start_ = std::min(soft_start_ + rules_.soft_start_step, 1.0);
    if (soft_start_ < 1) verdict.flags |= flag::kSoftStarting;
  }
  if (together_ != nullptr) {
    decide_together(in, out, verdict);
    return verdict;
  }
  for (std::size_t j = 0; j < joints_; ++j) {
    Rung& rung = joint_[j].rung = group_[joint_[j].group].rung;
    std::uint32_t& law_flags = joint_[j].law_flags = 0;
    if (rung == Rung::law) {
      apply_law(j, in, out, law_flags);
      verdict.law_flags |= law_flags;
    } else if (rung == Rung::safe_law) {
      apply_safe_law(j, in, out, verdict.flags);
    } else {
      switch_off(j, out);
    }
  }
  verdict.flags |= verdict.law_flags;
  return verdict;
}

Measured Guard::measured(std::size_t j, const Input& in) const LITHE_RT {
  constexpr std::int64_t kOldestNs = 1'000'000'000;
  const std::uint32_t unseen = joint_[j].unseen_ticks;
  return {in.position_rad[j], in.velocity_rad_s[j],
          1e-9 * static_cast<double>(std::clamp<std::int64_t>(in.sample_age_ns, 0, kOldestNs)) + period_s_ * unseen,
          in.stale_ticks + unseen};
}

// Predicted position when the next command reaches the drive.
Measured Guard::ahead(const Measured& now) const LITHE_RT {
  return {now.position_rad + now.velocity_rad_s * (now.age_s + period_s_), now.velocity_rad_s, 0};
}

Guard::Reach Guard::reach(const Joint& joint, const Measured& now, double step_nm) const LITHE_RT {
  const double most_nm = joint.limit.torque_max_nm;
  const double now_nm = std::clamp(joint.sent.felt_nm(ahead(now)), -most_nm, most_nm);
  return {now_nm, std::max(now_nm - step_nm, -most_nm), std::min(now_nm + step_nm, most_nm)};
}

double Guard::bound(Joint& joint, double wanted_nm, const Measured& now, double torque_max_nm, double step_nm,
                    std::uint32_t& flags) const LITHE_RT {
  const Limits& limit = joint.limit;
  const bool up = wanted_nm > 0;
  const double way_left_rad =
      up ? limit.position_max_rad - now.position_rad : now.position_rad - limit.position_min_rad;
  const double speed_left = limit.velocity_fault_rad_s - (up ? now.velocity_rad_s : -now.velocity_rad_s);
  const double position_room = room(way_left_rad, limit.soft_stop_per_rad);
  const double velocity_room = room(speed_left, limit.velocity_fade_s_rad);
  const double clamped = std::clamp(wanted_nm, -torque_max_nm, torque_max_nm);
  // Braking takes power out of a joint and is not limited.
  const bool strong = !(clamped * now.velocity_rad_s <= limit.power_max_w);
  const double powered = strong ? limit.power_max_w / now.velocity_rad_s : clamped;
  const double faded = powered * position_room * velocity_room;
  const Reach within = reach(joint, now, step_nm);
  const double slewed = std::clamp(faded, within.least_nm, within.most_nm);
  const double bounded = joint.envelope.bound(now, within.least_nm, slewed, within.most_nm);

  joint.at_envelope = bounded != slewed;
  if (strong) flags |= flag::kPowerClamped;
  if (clamped != wanted_nm) flags |= flag::kTorqueClamped;
  if ((wanted_nm != 0 && position_room < 1) || joint.at_envelope) flags |= flag::kPositionClamped;
  if (wanted_nm != 0 && velocity_room < 1) flags |= flag::kVelocityClamped;
  if (slewed != faded) flags |= flag::kSlewClamped;
  return bounded;
}

void Guard::remember(Joint& joint, const Measured& now, Command command) const LITHE_RT {
  const double most_nm = joint.limit.torque_max_nm;
  command.decided_nm = std::clamp(command.felt_nm(ahead(now)), -most_nm, most_nm);
  const Envelope::Drift drift = joint.envelope.drift(now, command.decided_nm, command.kp_nm_rad, command.kd_nm_s_rad);
  command.least_nm = std::max(command.decided_nm - drift.down_nm, -most_nm);
  command.most_nm = std::min(command.decided_nm + drift.up_nm, most_nm);
  joint.last = command;
}

// Limits the gains of the drive's PD. They change only so fast that the uncertainty of the joint's next state is a
// small part of a slew step; at the limits they are 0; and a stiffness may not change the torque with the joint's
// motion faster than the slew bound. Returns the rest of the slew step.
double Guard::settle_gains(const Joint& joint, const Measured& now, Command& command) const LITHE_RT {
  constexpr double kPart = 0.25;
  const double slew_nm = joint.limit.slew_nm, ahead_s = now.age_s + period_s_;
  const double unknown_rad = joint.envelope.unknown_rad(ahead_s), unknown_rad_s = joint.envelope.unknown_rad_s(ahead_s);
  if (unknown_rad_s <= 0) return slew_nm;
  if (joint.at_envelope) command.kp_nm_rad = command.kd_nm_s_rad = 0;
  const double kp_step = kPart * slew_nm / unknown_rad, kd_step = kPart * slew_nm / unknown_rad_s;
  const Command& sent = joint.sent;
  command.kp_nm_rad = std::min(command.kp_nm_rad, slew_nm / (period_s_ * std::abs(now.velocity_rad_s) + 1e-12));
  command.kp_nm_rad = std::clamp(command.kp_nm_rad, sent.kp_nm_rad - kp_step, sent.kp_nm_rad + kp_step);
  command.kd_nm_s_rad = std::clamp(command.kd_nm_s_rad, sent.kd_nm_s_rad - kd_step, sent.kd_nm_s_rad + kd_step);
  return slew_nm - std::abs(command.kp_nm_rad - sent.kp_nm_rad) * unknown_rad -
         std::abs(command.kd_nm_s_rad - sent.kd_nm_s_rad) * unknown_rad_s;
}

void Guard::apply_law(std::size_t j, const Input& in, JointCommands& out, std::uint32_t& flags) LITHE_RT {
  safe_law_.rearm(j);
  Joint& joint = joint_[j];
  const Limits& limit = joint.limit;
  const Measured now = measured(j, in), then = ahead(now);
  Command command{pd_of(in.effort, j)};
  command.kp_nm_rad = has_target(command.target_rad) ? std::clamp(command.kp_nm_rad, 0.0, limit.kp_max_nm_rad) : 0.0;
  command.kd_nm_s_rad = std::clamp(command.kd_nm_s_rad, 0.0, limit.kd_max_nm_s_rad);
  command.target_rad = std::clamp(command.target_rad, limit.position_min_rad, limit.position_max_rad);  // NaN stays NaN
  command.target_rad_s = std::clamp(command.target_rad_s, -limit.velocity_max_rad_s, limit.velocity_max_rad_s);
  if (limit.loop != robot::DriveLoop::torque) {
    const double down = speed_that_stops(now.position_rad - limit.position_min_rad, limit.deceleration_rad_s2);
    const double up = speed_that_stops(limit.position_max_rad - now.position_rad, limit.deceleration_rad_s2);
    command.target_rad_s = std::clamp(command.target_rad_s, -down, up);
  }
  const double wanted_nm = command.felt_nm(then);
  const double step_nm = settle_gains(joint, now, command);
  const double total_nm = bound(joint, wanted_nm, now, limit.torque_max_nm * soft_start_, step_nm, flags);
  // The feed-forward compensates the drive's PD beyond the bound; where it cannot, the gains are reduced.
  const double drive_nm = command.pd_nm(then);
  command.torque_nm = total_nm - drive_nm;
  if (std::abs(command.torque_nm) > limit.torque_max_nm) {
    command.torque_nm = std::copysign(limit.torque_max_nm, command.torque_nm);
    const double share = std::clamp((total_nm - command.torque_nm) / drive_nm, 0.0, 1.0);
    command.kp_nm_rad *= share;
    command.kd_nm_s_rad *= share;
  }
  remember(joint, now, command);
  // Also valid if no other command follows. Braking torque may exceed the soft-start limit of a law.
  out.set(j, command, std::max(limit.torque_max_nm * soft_start_, std::abs(total_nm)));
}

void Guard::apply_safe_law(std::size_t j, const Input& in, JointCommands& out, std::uint32_t& flags) LITHE_RT {
  Joint& joint = joint_[j];
  const double most_nm = joint.limit.torque_max_nm;
  if (!joint.usable || joint.limit.loop != robot::DriveLoop::torque) {
    safe_law_.rearm(j);  // its old reference is too old to resume
    return brake_blindly(j, out, flags);
  }
  const Measured now = measured(j, in);
  Command command;
  const double step_nm = settle_gains(joint, now, command);
  command.kp_nm_rad = 0;  // the position target is the law's
  const double wanted_nm = safe_law_.torque_nm(j, now.position_rad, now.velocity_rad_s);
  const double total_nm = bound(joint, wanted_nm, now, most_nm, step_nm, flags);
  command.torque_nm = total_nm - command.pd_nm(ahead(now));
  remember(joint, now, command);
  out.set(j, command, most_nm);
}

// Without a sample, or with a loop of its own, only the drive can brake the joint; without any torque it would fall.
void Guard::brake_blindly(std::size_t j, JointCommands& out, std::uint32_t& flags) LITHE_RT {
  Joint& joint = joint_[j];
  const Limits& limit = joint.limit;
  const double sent_nm = joint.sent.decided_nm, sent_kd = joint.sent.blind_kd_nm_s_rad;
  Command command;
  command.torque_nm = command.decided_nm = std::copysign(std::max(std::abs(sent_nm) - limit.slew_nm, 0.0), sent_nm);
  command.kd_nm_s_rad =
      sent_nm == 0.0 ? std::min(sent_kd + limit.blind_kd_step_nm_s_rad, limit.blind_kd_nm_s_rad) : sent_kd;
  command.blind_kd_nm_s_rad = command.kd_nm_s_rad;
  const double damping_nm = std::min(command.kd_nm_s_rad * limit.velocity_fault_rad_s, limit.torque_max_nm);
  command.least_nm = command.torque_nm - damping_nm;
  command.most_nm = command.torque_nm + damping_nm;
  if (command.torque_nm != 0) flags |= flag::kSlewClamped;
  joint.last = command;
  out.set(j, command, limit.torque_max_nm);
}

void Guard::switch_off(std::size_t j, JointCommands& out) LITHE_RT {
  safe_law_.rearm(j);
  joint_[j].last = {};
  out.set(j, {}, 0.0);
}

void Guard::start_recovery() LITHE_RT { recovery_.restart(); }

// Slew-bounded from what each joint feels now, as every other output is, and bounded as every other by what still stops
// before a limit: both, or of a joint that comes from beyond one of them, the other. So a load above the torque of the
// recovery does not carry it through its range.
void Guard::recover(const Input& in, JointCommands& out, Verdict& verdict) LITHE_RT {
  verdict.recovered = true;
  for (std::size_t j = 0; j < joints_; ++j) {
    Joint& joint = joint_[j];
    joint.rung = Rung::law;
    if (joint.limit.loop != robot::DriveLoop::torque) {
      recover_by_target(j, in, out);
      verdict.recovered = verdict.recovered && recovery_.recovered(j);
      continue;
    }
    const Measured now = measured(j, in);
    const Reach within = reach(joint, now, joint.limit.slew_nm);
    const double wanted_nm = recovery_.torque_nm(j, now.position_rad, now.velocity_rad_s, within.now_nm);
    const double slewed_nm = std::clamp(wanted_nm, within.least_nm, within.most_nm);
    const int from = recovery_.from(j);
    Command command;
    command.torque_nm = from == 0 ? joint.envelope.bound(now, within.least_nm, slewed_nm, within.most_nm)
                                  : joint.envelope.bound_one(now, within.least_nm, slewed_nm, within.most_nm, from < 0);
    if (slewed_nm != wanted_nm) verdict.flags |= flag::kSlewClamped;
    if (command.torque_nm != slewed_nm) verdict.flags |= flag::kPositionClamped;
    safe_law_.rearm(j);
    remember(joint, now, command);
    joint.at_envelope = false;
    out.set(j, command, std::max(recovery_.torque_cap_nm(j), std::abs(command.torque_nm)));
    verdict.recovered = verdict.recovered && recovery_.recovered(j);
  }
  if (!verdict.recovered) verdict.flags |= flag::kRecovering;
  soft_start_ = recovery_.share();  // a law that follows has at least the torque that holds the joints now
}

// The offset of what ran before fades; the drive's own loop carries the load.
void Guard::recover_by_target(std::size_t j, const Input& in, JointCommands& out) LITHE_RT {
  Joint& joint = joint_[j];
  const Measured now = measured(j, in);
  const Reach within = reach(joint, now, joint.limit.slew_nm);
  const double torque_nm = in.torque_nm != nullptr ? (*in.torque_nm)[j] : 0.0;
  Command command;
  command.torque_nm = std::clamp(0.0, within.least_nm, within.most_nm);
  command.target_rad_s = recovery_.target_rad_s(j, now.position_rad, torque_nm);
  safe_law_.rearm(j);
  remember(joint, now, command);
  out.set(j, command, recovery_.torque_cap_nm(j));
}

}  // namespace lithe::guard
