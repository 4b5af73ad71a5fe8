// SPDX-License-Identifier: Apache-2.0
#include "spine/guard/guard.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace lithe::guard {
namespace {

using wire::Fault;
using wire::Mode;

constexpr double kNone = std::numeric_limits<double>::quiet_NaN();

double reciprocal(double width) { return 1.0 / std::max(width, 1.0e-9); }

// 1 where there is room, 0 where there is none, straight in between.
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
  }
  configure_groups(robot);
  safe_law_.configure(robot);
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
  blind_kd_nm_s_rad_.fill(0.0);
  soft_start_ = 0;
  for (Group& group : group_) {
    group.ticks_at_rest = group.ticks_seen_at_rest = 0;
    group.rung = Rung::law;
  }
  dispatched();
  for (std::size_t j = 0; j < joints_; ++j) safe_law_.rearm(j);
}

void Guard::dispatched() LITHE_RT {
  for (std::size_t j = 0; j < joints_; ++j) {
    sent_nm_[j] = last_nm_[j];
    sent_blind_kd_nm_s_rad_[j] = blind_kd_nm_s_rad_[j];
  }
}

Verdict Guard::check(const Input& in, Output& out) LITHE_RT {
  Verdict verdict;
  const Fault fault = judge(in, verdict);
  const bool driven = in.mode == Mode::active || in.mode == Mode::hold || in.mode == Mode::safe_stop;
  if (!driven) {
    for (std::size_t j = 0; j < joints_; ++j) {
      switch_off(j, out);
      out.rung[j] = in.mode == Mode::estop ? group_[group_of_[j]].rung : Rung::law;
    }
    return {.flags = verdict.flags};
  }
  verdict.fault = fault;
  descend_all(in, verdict.use_safe_law);
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

// Braking a joint takes power out of it, and is not limited.
double Guard::powered(std::size_t j, double torque_nm, double velocity_rad_s, std::uint32_t& flags) const LITHE_RT {
  if (torque_nm * velocity_rad_s <= limits_[j].power_max_w) return torque_nm;
  flags |= wire::telemetry_flag::kPowerClamped;
  return limits_[j].power_max_w / velocity_rad_s;
}

double Guard::bound(std::size_t j, double wanted_nm, double position_rad, double velocity_rad_s, double torque_max_nm,
                    std::uint32_t& flags) LITHE_RT {
  const Limits& limit = limits_[j];
  const bool up = wanted_nm > 0;
  const double way_left_rad = up ? limit.position_max_rad - position_rad : position_rad - limit.position_min_rad;
  const double speed_left = limit.velocity_fault_rad_s - (up ? velocity_rad_s : -velocity_rad_s);
  const double position_room = room(way_left_rad, limit.soft_stop_per_rad);
  const double velocity_room = room(speed_left, limit.velocity_fade_s_rad);
  const double clamped = std::clamp(wanted_nm, -torque_max_nm, torque_max_nm);
  const double faded = powered(j, clamped, velocity_rad_s, flags) * position_room * velocity_room;
  // What the joint feels now. After blindness that is the drive's own damping, at the speed known again.
  const double now_nm =
      std::clamp(sent_nm_[j] - sent_blind_kd_nm_s_rad_[j] * velocity_rad_s, -limit.torque_max_nm, limit.torque_max_nm);
  const double step = std::clamp(faded - now_nm, -limit.slew_nm, limit.slew_nm);
  const double bounded = std::clamp(now_nm + step, -limit.torque_max_nm, limit.torque_max_nm);

  if (clamped != wanted_nm) flags |= wire::telemetry_flag::kTorqueClamped;
  if (wanted_nm != 0 && position_room < 1) flags |= wire::telemetry_flag::kPositionClamped;
  if (wanted_nm != 0 && velocity_room < 1) flags |= wire::telemetry_flag::kVelocityClamped;
  if (step != faded - now_nm) flags |= wire::telemetry_flag::kSlewClamped;
  last_nm_[j] = bounded;
  blind_kd_nm_s_rad_[j] = 0.0;
  return bounded;
}

void Guard::apply_law(std::size_t j, const Input& in, Output& out, std::uint32_t& flags) LITHE_RT {
  safe_law_.rearm(j);
  const Limits& limit = limits_[j];
  const double position_rad = in.position_rad[j];
  const double velocity_rad_s = in.velocity_rad_s[j];
  const double target_rad = std::clamp(in.proposal.position_rad[j], limit.position_min_rad, limit.position_max_rad);
  const double target_rad_s =
      std::clamp(in.proposal.velocity_rad_s[j], -limit.velocity_max_rad_s, limit.velocity_max_rad_s);
  const bool has_target = !std::isnan(in.proposal.position_rad[j]);
  double kp = has_target ? std::clamp(in.proposal.kp_nm_rad[j], 0.0, limit.kp_max_nm_rad) : 0.0;
  double kd = std::clamp(in.proposal.kd_nm_s_rad[j], 0.0, limit.kd_max_nm_s_rad);
  const double drive_nm = (has_target ? kp * (target_rad - position_rad) : 0.0) + kd * (target_rad_s - velocity_rad_s);

  const double total_nm = bound(j, in.proposal.torque_nm[j] + drive_nm, position_rad, velocity_rad_s,
                                limit.torque_max_nm * soft_start_, flags);
  // The feed-forward makes up for what the drive's own PD does beyond the bound; where it cannot, the gains give way.
  double torque_nm = total_nm - drive_nm;
  if (std::abs(torque_nm) > limit.torque_max_nm) {
    torque_nm = std::copysign(limit.torque_max_nm, torque_nm);
    const double share = std::clamp((total_nm - torque_nm) / drive_nm, 0.0, 1.0);
    kp *= share;
    kd *= share;
  }
  out.torque_nm[j] = torque_nm;
  out.position_rad[j] = target_rad;
  out.velocity_rad_s[j] = target_rad_s;
  out.kp_nm_rad[j] = kp;
  out.kd_nm_s_rad[j] = kd;
  out.max_torque_nm[j] = limit.torque_max_nm * soft_start_;  // also if no other command follows
}

void Guard::apply_safe_law(std::size_t j, const Input& in, Output& out, std::uint32_t& flags) LITHE_RT {
  out.position_rad[j] = kNone;
  out.velocity_rad_s[j] = 0.0;
  out.kp_nm_rad[j] = 0.0;
  out.kd_nm_s_rad[j] = 0.0;
  out.max_torque_nm[j] = limits_[j].torque_max_nm;
  if (!usable_[j]) {
    safe_law_.rearm(j);  // what it meant to follow is too old to resume
    return brake_blindly(j, out, flags);
  }
  const double wanted_nm = safe_law_.torque_nm(j, in.position_rad[j], in.velocity_rad_s[j]);
  out.torque_nm[j] = bound(j, wanted_nm, in.position_rad[j], in.velocity_rad_s[j], limits_[j].torque_max_nm, flags);
}

// Without a sample only the drive can brake the joint; with no torque at all it would fall.
void Guard::brake_blindly(std::size_t j, Output& out, std::uint32_t& flags) LITHE_RT {
  const double grown =
      std::min(sent_blind_kd_nm_s_rad_[j] + limits_[j].blind_kd_step_nm_s_rad, limits_[j].blind_kd_nm_s_rad);
  const double kd = sent_nm_[j] == 0.0 ? grown : sent_blind_kd_nm_s_rad_[j];
  out.torque_nm[j] = bound(j, 0.0, 0.0, 0.0, limits_[j].torque_max_nm, flags);
  out.kd_nm_s_rad[j] = blind_kd_nm_s_rad_[j] = kd;
}

void Guard::switch_off(std::size_t j, Output& out) LITHE_RT {
  safe_law_.rearm(j);
  out.torque_nm[j] = out.velocity_rad_s[j] = out.kp_nm_rad[j] = out.kd_nm_s_rad[j] = out.max_torque_nm[j] = 0.0;
  out.position_rad[j] = kNone;
  last_nm_[j] = blind_kd_nm_s_rad_[j] = 0.0;
}

}  // namespace lithe::guard
