// SPDX-License-Identifier: Apache-2.0
#include "spine/guard/guard.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace lithe::guard {
namespace {

using wire::Fault;
using wire::Mode;

double reciprocal(double width) { return 1.0 / std::max(width, 1.0e-9); }

// 1 where there is room, 0 where there is none, linear in between.
double room(double distance, double per_width) LITHE_RT { return std::clamp(distance * per_width, 0.0, 1.0); }

}  // namespace

void Guard::configure(const robot::RobotConfig& robot) {
  joints_ = std::min(robot.joints.size(), kMaxJoints);
  late_ticks_to_stop_ = robot.spine.late_ticks_to_stop;
  brain_stale_ns_ = static_cast<std::int64_t>(robot.brain.stale_after_s * 1.0e9);
  stop_when_brain_stale_ = robot.brain.on_stale == robot::StaleAction::safe_stop;
  const auto ticks_of = [&robot](double time_s) {
    return static_cast<std::uint64_t>(std::ceil(time_s * robot.rate_hz));
  };
  period_s_ = 1.0 / robot.rate_hz;
  brake_after_ticks_ = ticks_of(robot.guard.brake_after_s);
  off_after_ticks_ = ticks_of(robot.guard.off_after_s);
  soft_start_step_ = 1.0 / std::max(robot.guard.soft_start_s * robot.rate_hz, 1.0);
  for (std::size_t j = 0; j < joints_; ++j) {
    const robot::JointConfig& joint = robot.joints[j];
    const double fault_rad_s = joint.velocity_max_rad_s * robot.guard.velocity_overrun;
    limits_[j] =
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
               .kp_max_nm_rad = joint.kp_max_nm_rad,
               .kd_max_nm_s_rad = joint.kd_max_nm_s_rad,
               .blind_kd_nm_s_rad = joint.safe_kd_nm_s_rad,
               .blind_kd_step_nm_s_rad = joint.torque_slew_nm_s / robot.rate_hz / fault_rad_s,
               .must_be_homed = joint.must_be_homed};
    envelope_[j].configure(robot, joint);
  }
  configure_groups(robot);
  safe_law_.configure(robot);
  recovery_.configure(robot);
  reset_output();
}

void Guard::configure_groups(const robot::RobotConfig& robot) {
  others_go_on_ = robot.guard.other_groups == robot::OtherGroups::go_on;
  groups_ = 0;
  for (std::size_t j = 0; j < joints_; ++j) {
    const auto first = std::find_if(robot.joints.begin(), robot.joints.end(), [&](const robot::JointConfig& joint) {
      return joint.group == robot.joints[j].group;
    });
    const auto leader = static_cast<std::size_t>(first - robot.joints.begin());
    group_of_[j] = leader < j ? group_of_[leader] : static_cast<std::uint8_t>(groups_++);
  }
  forget_faults();
}

void Guard::reset_output() LITHE_RT {
  last_nm_.fill(0.0);
  last_.fill({});
  at_envelope_.fill(false);
  blind_kd_nm_s_rad_.fill(0.0);
  soft_start_ = 0;
  for (Group& group : group_) {
    group.ticks_at_rest = group.ticks_seen_at_rest = 0;
    group.rung = Rung::law;
  }
  dispatched();
  for (std::size_t j = 0; j < joints_; ++j) {
    safe_law_.rearm(j);
    envelope_[j].forget();
  }
}

void Guard::dispatched() LITHE_RT {
  for (std::size_t j = 0; j < joints_; ++j) {
    sent_[j] = last_[j];
    sent_blind_kd_nm_s_rad_[j] = blind_kd_nm_s_rad_[j];
  }
}

Verdict Guard::check(const Input& in, Output& out) LITHE_RT {
  Verdict verdict;
  const Fault fault = judge(in, verdict);
  const bool driven =
      in.mode == Mode::active || in.mode == Mode::hold || in.mode == Mode::safe_stop || in.mode == Mode::recover;
  if (!driven) {
    for (std::size_t j = 0; j < joints_; ++j) {
      switch_off(j, out);
      out.rung[j] = in.mode == Mode::estop ? group_[group_of_[j]].rung : Rung::law;
    }
    return {.flags = verdict.flags};
  }
  for (std::size_t j = 0; j < joints_; ++j) envelope_[j].in_flight(sent_[j].least_nm, sent_[j].most_nm);
  verdict.fault = fault;
  verdict.recovering = in.mode == Mode::recover;
  descend_all(in, verdict.use_safe_law);
  if (verdict.recovering && !verdict.use_safe_law) {
    recover(in, out, verdict);
    return verdict;
  }
  if (!verdict.use_safe_law) {
    soft_start_ = std::min(soft_start_ + soft_start_step_, 1.0);
    if (soft_start_ < 1) verdict.flags |= wire::telemetry_flag::kSoftStarting;
  }
  for (std::size_t j = 0; j < joints_; ++j) {
    out.rung[j] = group_[group_of_[j]].rung;
    if (out.rung[j] == Rung::law) {
      apply_law(j, in, out, verdict.law_flags);
    } else if (out.rung[j] == Rung::safe_law) {
      apply_safe_law(j, in, out, verdict.flags);
    } else {
      switch_off(j, out);
    }
  }
  verdict.flags |= verdict.law_flags;
  return verdict;
}

// Braking takes power out of a joint and is not limited.
double Guard::powered(std::size_t j, double torque_nm, double velocity_rad_s, std::uint32_t& flags) const LITHE_RT {
  if (torque_nm * velocity_rad_s <= limits_[j].power_max_w) return torque_nm;
  flags |= wire::telemetry_flag::kPowerClamped;
  return limits_[j].power_max_w / velocity_rad_s;
}

Seen Guard::seen(std::size_t j, const Input& in) const LITHE_RT {
  constexpr std::int64_t kOldestNs = 1'000'000'000;
  return {in.position_rad[j], in.velocity_rad_s[j],
          1e-9 * static_cast<double>(std::clamp<std::int64_t>(in.sample_age_ns, 0, kOldestNs))};
}

// Predicted position when the next command reaches the drive.
Seen Guard::ahead(const Seen& seen) const LITHE_RT {
  return {seen.position_rad + seen.velocity_rad_s * (seen.age_s + period_s_), seen.velocity_rad_s, 0};
}

double Guard::bound(std::size_t j, double wanted_nm, const Seen& seen, double torque_max_nm, double step_nm,
                    std::uint32_t& flags) LITHE_RT {
  const Limits& limit = limits_[j];
  const bool up = wanted_nm > 0;
  const double way_left_rad =
      up ? limit.position_max_rad - seen.position_rad : seen.position_rad - limit.position_min_rad;
  const double speed_left = limit.velocity_fault_rad_s - (up ? seen.velocity_rad_s : -seen.velocity_rad_s);
  const double position_room = room(way_left_rad, limit.soft_stop_per_rad);
  const double velocity_room = room(speed_left, limit.velocity_fade_s_rad);
  const double clamped = std::clamp(wanted_nm, -torque_max_nm, torque_max_nm);
  const double faded = powered(j, clamped, seen.velocity_rad_s, flags) * position_room * velocity_room;
  // Torque at the joint when the new command takes over.
  const double now_nm = std::clamp(sent_[j].felt_nm(ahead(seen)), -limit.torque_max_nm, limit.torque_max_nm);
  const double least_nm = std::max(now_nm - step_nm, -limit.torque_max_nm);
  const double most_nm = std::min(now_nm + step_nm, limit.torque_max_nm);
  const double slewed = std::clamp(faded, least_nm, most_nm);
  const double bounded = envelope_[j].bound(seen, least_nm, slewed, most_nm);

  at_envelope_[j] = bounded != slewed;
  if (clamped != wanted_nm) flags |= wire::telemetry_flag::kTorqueClamped;
  if ((wanted_nm != 0 && position_room < 1) || at_envelope_[j]) flags |= wire::telemetry_flag::kPositionClamped;
  if (wanted_nm != 0 && velocity_room < 1) flags |= wire::telemetry_flag::kVelocityClamped;
  if (slewed != faded) flags |= wire::telemetry_flag::kSlewClamped;
  return bounded;
}

void Guard::remember(std::size_t j, const Seen& seen, Command command) LITHE_RT {
  const double most_nm = limits_[j].torque_max_nm;
  command.decided_nm = std::clamp(command.felt_nm(ahead(seen)), -most_nm, most_nm);
  const Envelope::Drift drift = envelope_[j].drift(seen, command.decided_nm, command.kp_nm_rad, command.kd_nm_s_rad);
  command.least_nm = std::max(command.decided_nm - drift.down_nm, -most_nm);
  command.most_nm = std::min(command.decided_nm + drift.up_nm, most_nm);
  last_[j] = command;
  last_nm_[j] = command.decided_nm;
  blind_kd_nm_s_rad_[j] = 0.0;
}

Guard::Command Guard::wanted_pd(std::size_t j, const Effort& effort) const LITHE_RT {
  const Limits& limit = limits_[j];
  Command pd;
  pd.torque_nm = effort.torque_nm[j];
  pd.kp_nm_rad = has_target(effort.position_rad[j]) ? std::clamp(effort.kp_nm_rad[j], 0.0, limit.kp_max_nm_rad) : 0.0;
  pd.kd_nm_s_rad = std::clamp(effort.kd_nm_s_rad[j], 0.0, limit.kd_max_nm_s_rad);
  pd.target_rad = std::clamp(effort.position_rad[j], limit.position_min_rad, limit.position_max_rad);  // NaN stays NaN
  pd.target_rad_s = std::clamp(effort.velocity_rad_s[j], -limit.velocity_max_rad_s, limit.velocity_max_rad_s);
  return pd;
}

// Limits the gains of the drive's PD. They change only so fast that the uncertainty of the joint's next state is a
// small part of a slew step; at the limits they are 0; and a stiffness may not change the torque with the joint's
// motion faster than the slew bound. Returns the rest of the slew step.
double Guard::settle_gains(std::size_t j, const Seen& seen, Command& command) const LITHE_RT {
  constexpr double kPart = 0.25;
  const Limits& limit = limits_[j];
  const double ahead_s = seen.age_s + period_s_;
  const double unknown_rad = envelope_[j].unknown_rad(ahead_s), unknown_rad_s = envelope_[j].unknown_rad_s(ahead_s);
  if (unknown_rad_s <= 0) return limit.slew_nm;
  if (at_envelope_[j]) command.kp_nm_rad = command.kd_nm_s_rad = 0;
  const double kp_step = kPart * limit.slew_nm / unknown_rad, kd_step = kPart * limit.slew_nm / unknown_rad_s;
  const Command& sent = sent_[j];
  command.kp_nm_rad = std::min(command.kp_nm_rad, limit.slew_nm / (period_s_ * std::abs(seen.velocity_rad_s) + 1e-12));
  command.kp_nm_rad = std::clamp(command.kp_nm_rad, sent.kp_nm_rad - kp_step, sent.kp_nm_rad + kp_step);
  command.kd_nm_s_rad = std::clamp(command.kd_nm_s_rad, sent.kd_nm_s_rad - kd_step, sent.kd_nm_s_rad + kd_step);
  return limit.slew_nm - std::abs(command.kp_nm_rad - sent.kp_nm_rad) * unknown_rad -
         std::abs(command.kd_nm_s_rad - sent.kd_nm_s_rad) * unknown_rad_s;
}

void Guard::apply_law(std::size_t j, const Input& in, Output& out, std::uint32_t& flags) LITHE_RT {
  safe_law_.rearm(j);
  const Limits& limit = limits_[j];
  const Seen now = seen(j, in), then = ahead(now);
  Command command = wanted_pd(j, in.effort);
  const double wanted_nm = command.felt_nm(then);
  const double step_nm = settle_gains(j, now, command);
  const double total_nm = bound(j, wanted_nm, now, limit.torque_max_nm * soft_start_, step_nm, flags);
  // The feed-forward compensates the drive's PD beyond the bound; where it cannot, the gains are reduced.
  const double drive_nm = command.pd_nm(then);
  command.torque_nm = total_nm - drive_nm;
  if (std::abs(command.torque_nm) > limit.torque_max_nm) {
    command.torque_nm = std::copysign(limit.torque_max_nm, command.torque_nm);
    const double share = std::clamp((total_nm - command.torque_nm) / drive_nm, 0.0, 1.0);
    command.kp_nm_rad *= share;
    command.kd_nm_s_rad *= share;
  }
  remember(j, now, command);
  out.torque_nm[j] = command.torque_nm;
  out.position_rad[j] = command.target_rad;
  out.velocity_rad_s[j] = command.target_rad_s;
  out.kp_nm_rad[j] = command.kp_nm_rad;
  out.kd_nm_s_rad[j] = command.kd_nm_s_rad;
  // Also valid if no other command follows. Braking torque may exceed the soft-start limit of a law.
  out.max_torque_nm[j] = std::max(limit.torque_max_nm * soft_start_, std::abs(total_nm));
}

void Guard::apply_safe_law(std::size_t j, const Input& in, Output& out, std::uint32_t& flags) LITHE_RT {
  out.position_rad[j] = kNoTarget;
  out.velocity_rad_s[j] = 0.0;
  out.kp_nm_rad[j] = 0.0;
  out.kd_nm_s_rad[j] = 0.0;
  out.max_torque_nm[j] = limits_[j].torque_max_nm;
  if (!usable_[j]) {
    safe_law_.rearm(j);  // its old reference is too old to resume
    return brake_blindly(j, out, flags);
  }
  const Seen now = seen(j, in);
  Command command;
  const double step_nm = settle_gains(j, now, command);
  command.kp_nm_rad = 0;  // the position target is the law's
  const double wanted_nm = safe_law_.torque_nm(j, now.position_rad, now.velocity_rad_s);
  const double total_nm = bound(j, wanted_nm, now, limits_[j].torque_max_nm, step_nm, flags);
  command.torque_nm = total_nm - command.pd_nm(ahead(now));
  remember(j, now, command);
  out.torque_nm[j] = command.torque_nm;
  out.kd_nm_s_rad[j] = command.kd_nm_s_rad;
}

// Without a sample only the drive can brake the joint; without any torque it would fall.
void Guard::brake_blindly(std::size_t j, Output& out, std::uint32_t& flags) LITHE_RT {
  const double grown =
      std::min(sent_blind_kd_nm_s_rad_[j] + limits_[j].blind_kd_step_nm_s_rad, limits_[j].blind_kd_nm_s_rad);
  const Limits& limit = limits_[j];
  Command command;
  command.torque_nm = command.decided_nm = last_nm_[j] =
      std::copysign(std::max(std::abs(sent_[j].decided_nm) - limit.slew_nm, 0.0), sent_[j].decided_nm);
  command.kd_nm_s_rad = sent_[j].decided_nm == 0.0 ? grown : sent_blind_kd_nm_s_rad_[j];
  const double damping_nm = std::min(command.kd_nm_s_rad * limit.velocity_fault_rad_s, limit.torque_max_nm);
  command.least_nm = command.torque_nm - damping_nm;
  command.most_nm = command.torque_nm + damping_nm;
  if (command.torque_nm != 0) flags |= wire::telemetry_flag::kSlewClamped;
  last_[j] = command;
  out.torque_nm[j] = command.torque_nm;
  out.kd_nm_s_rad[j] = blind_kd_nm_s_rad_[j] = command.kd_nm_s_rad;
}

void Guard::switch_off(std::size_t j, Output& out) LITHE_RT {
  safe_law_.rearm(j);
  out.torque_nm[j] = out.velocity_rad_s[j] = out.kp_nm_rad[j] = out.kd_nm_s_rad[j] = out.max_torque_nm[j] = 0.0;
  out.position_rad[j] = kNoTarget;
  last_[j] = {};
  last_nm_[j] = blind_kd_nm_s_rad_[j] = 0.0;
}

}  // namespace lithe::guard
