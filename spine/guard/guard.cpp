// SPDX-License-Identifier: Apache-2.0
#include "spine/guard/guard.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace lithe::guard {
namespace {

using wire::Fault;
using wire::Mode;

// No joint is here and none turns this fast: such a sample is noise, and products with it could overflow.
constexpr double kAbsurd = 1.0e6;
constexpr double kAtRestRadS = 0.05;
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
               .blind_kd_step_nm_s_rad = joint.torque_slew_nm_s / robot.rate_hz / fault_rad_s};
  }
  safe_law_.configure(robot);
  reset_output();
}

void Guard::reset_output() LITHE_RT {
  last_nm_.fill(0.0);
  blind_kd_nm_s_rad_.fill(0.0);
  soft_start_ = 0;
  ticks_at_rest_ = ticks_seen_at_rest_ = 0;
  dispatched();
  safe_law_.rearm();
}

void Guard::dispatched() LITHE_RT {
  for (std::size_t j = 0; j < joints_; ++j) {
    sent_nm_[j] = last_nm_[j];
    sent_blind_kd_nm_s_rad_[j] = blind_kd_nm_s_rad_[j];
  }
}

Verdict Guard::check(const Input& in, Output& out) LITHE_RT {
  Verdict verdict;
  const Fault fault = judge(in, verdict.flags);
  if (in.mode != Mode::active && in.mode != Mode::hold && in.mode != Mode::safe_stop) {
    switch_off(out);
    return verdict;
  }
  verdict.fault = fault;
  verdict.use_safe_law = fault != Fault::none || in.mode == Mode::safe_stop;
  if (verdict.use_safe_law) {
    verdict.rung = descend(in);
    if (verdict.rung == Rung::safe_law) {
      apply_safe_law(in, out, verdict.flags);
    } else {
      switch_off(out);
    }
  } else {
    safe_law_.rearm();
    ticks_at_rest_ = ticks_seen_at_rest_ = 0;
    soft_start_ = std::min(soft_start_ + soft_start_step_, 1.0);
    if (soft_start_ < 1) verdict.flags |= wire::telemetry_flag::kSoftStarting;
    apply_law(in, out, verdict.flags);
  }
  return verdict;
}

// The worst thing there is to say about this tick. Also finds out which samples are usable.
Fault Guard::judge(const Input& in, std::uint32_t& flags) LITHE_RT {
  const bool too_late = in.stale_ticks >= late_ticks_to_stop_;
  bool all_usable = true;
  for (std::size_t j = 0; j < joints_; ++j) {
    const bool sane = std::abs(in.position_rad[j]) < kAbsurd && std::abs(in.velocity_rad_s[j]) < kAbsurd;
    usable_[j] = sane && !too_late && (in.joint_status[j] & wire::joint_status::kLost) == 0;
    all_usable = all_usable && sane;
  }
  if (in.stale_ticks > 0) flags |= wire::telemetry_flag::kSampleStale;
  const bool brain_stale = in.brain_age_ns < 0 || in.brain_age_ns > brain_stale_ns_;
  if (brain_stale) flags |= wire::telemetry_flag::kBrainStale;
  const bool law_runs = in.mode == Mode::active || in.mode == Mode::hold;
  const bool finite = !law_runs || proposal_is_finite(in.proposal);
  if (!finite) flags |= wire::telemetry_flag::kNotFinite;

  if (const Fault fault = judge_drives(in); fault != Fault::none) return fault;
  if (too_late || !all_usable) return Fault::sample_stale;
  if (!finite) return Fault::law_not_finite;
  if (const Fault fault = judge_motion(in); fault != Fault::none) return fault;
  return brain_stale && stop_when_brain_stale_ ? Fault::brain_stale : Fault::none;
}

Fault Guard::judge_drives(const Input& in) const LITHE_RT {
  std::uint32_t seen = 0;
  for (std::size_t j = 0; j < joints_; ++j) seen |= in.joint_status[j];
  if ((seen & wire::joint_status::kFault) != 0) return Fault::drive_fault;
  if ((seen & wire::joint_status::kWatchdog) != 0) return Fault::drive_watchdog;
  if ((seen & wire::joint_status::kLost) != 0) return Fault::drive_lost;
  return Fault::none;
}

Fault Guard::judge_motion(const Input& in) const LITHE_RT {
  bool outside = false;
  bool too_fast = false;
  for (std::size_t j = 0; j < joints_; ++j) {
    const Limits& limit = limits_[j];
    outside |= in.position_rad[j] > limit.position_max_rad + limit.overrun_rad ||
               in.position_rad[j] < limit.position_min_rad - limit.overrun_rad;
    too_fast |= std::abs(in.velocity_rad_s[j]) > limit.velocity_fault_rad_s;
  }
  if (outside) return Fault::position_limit;
  return too_fast ? Fault::velocity_limit : Fault::none;
}

bool Guard::proposal_is_finite(const Proposal& proposal) const LITHE_RT {
  bool finite = true;
  for (std::size_t j = 0; j < joints_; ++j) {
    // x - x is 0 for every finite x and NaN for the others; a position may be absent (NaN) but not infinite.
    const double sum =
        (proposal.torque_nm[j] - proposal.torque_nm[j]) + (proposal.velocity_rad_s[j] - proposal.velocity_rad_s[j]) +
        (proposal.kp_nm_rad[j] - proposal.kp_nm_rad[j]) + (proposal.kd_nm_s_rad[j] - proposal.kd_nm_s_rad[j]);
    finite = finite && sum == 0.0 && !std::isinf(proposal.position_rad[j]);
  }
  return finite;
}

// How far down the ladder. For braking, joints whose samples are no basis for anything do not count as moving: the
// drive damps them, and nobody may ever know that they are at rest. Letting go is another matter: only what was seen at
// rest for so long, every joint of it, does not fall then.
Rung Guard::descend(const Input& in) LITHE_RT {
  if (in.mode != Mode::safe_stop) return Rung::safe_law;  // not latched yet
  bool at_rest = true;
  bool seen_at_rest = true;
  for (std::size_t j = 0; j < joints_; ++j) {
    const bool slow = std::abs(in.velocity_rad_s[j]) < kAtRestRadS;
    at_rest = at_rest && (!usable_[j] || slow);
    seen_at_rest = seen_at_rest && usable_[j] && slow;
  }
  const bool braked = brake_after_ticks_ != 0 && ticks_at_rest_ >= brake_after_ticks_;
  const bool off = off_after_ticks_ != 0 && ticks_seen_at_rest_ >= off_after_ticks_;
  // Once it brakes, a push does not let it go again.
  ticks_at_rest_ = at_rest || braked ? ticks_at_rest_ + 1 : 0;
  ticks_seen_at_rest_ = seen_at_rest || off ? ticks_seen_at_rest_ + 1 : 0;
  if (off) return Rung::off;
  return braked ? Rung::brake : Rung::safe_law;
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

void Guard::apply_law(const Input& in, Output& out, std::uint32_t& flags) LITHE_RT {
  for (std::size_t j = 0; j < joints_; ++j) {
    const Limits& limit = limits_[j];
    const double position_rad = in.position_rad[j];
    const double velocity_rad_s = in.velocity_rad_s[j];
    const double target_rad = std::clamp(in.proposal.position_rad[j], limit.position_min_rad, limit.position_max_rad);
    const double target_rad_s =
        std::clamp(in.proposal.velocity_rad_s[j], -limit.velocity_max_rad_s, limit.velocity_max_rad_s);
    const bool has_target = !std::isnan(in.proposal.position_rad[j]);
    double kp = has_target ? std::clamp(in.proposal.kp_nm_rad[j], 0.0, limit.kp_max_nm_rad) : 0.0;
    double kd = std::clamp(in.proposal.kd_nm_s_rad[j], 0.0, limit.kd_max_nm_s_rad);
    const double drive_nm =
        (has_target ? kp * (target_rad - position_rad) : 0.0) + kd * (target_rad_s - velocity_rad_s);

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
}

void Guard::apply_safe_law(const Input& in, Output& out, std::uint32_t& flags) LITHE_RT {
  safe_law_.step(in.position_rad, in.velocity_rad_s, usable_, out.torque_nm);
  for (std::size_t j = 0; j < joints_; ++j) {
    out.position_rad[j] = kNone;
    out.velocity_rad_s[j] = 0.0;
    out.kp_nm_rad[j] = 0.0;
    out.kd_nm_s_rad[j] = 0.0;
    out.max_torque_nm[j] = limits_[j].torque_max_nm;
    if (usable_[j]) {
      out.torque_nm[j] =
          bound(j, out.torque_nm[j], in.position_rad[j], in.velocity_rad_s[j], limits_[j].torque_max_nm, flags);
    } else {
      brake_blindly(j, out, flags);
    }
  }
}

// Without a sample only the drive can brake the joint; with no torque at all it would fall.
void Guard::brake_blindly(std::size_t j, Output& out, std::uint32_t& flags) LITHE_RT {
  const double grown =
      std::min(sent_blind_kd_nm_s_rad_[j] + limits_[j].blind_kd_step_nm_s_rad, limits_[j].blind_kd_nm_s_rad);
  const double kd = sent_nm_[j] == 0.0 ? grown : sent_blind_kd_nm_s_rad_[j];
  out.torque_nm[j] = bound(j, 0.0, 0.0, 0.0, limits_[j].torque_max_nm, flags);
  out.kd_nm_s_rad[j] = blind_kd_nm_s_rad_[j] = kd;
}

void Guard::switch_off(Output& out) LITHE_RT {
  safe_law_.rearm();
  for (std::size_t j = 0; j < joints_; ++j) {
    out.torque_nm[j] = out.velocity_rad_s[j] = out.kp_nm_rad[j] = out.kd_nm_s_rad[j] = out.max_torque_nm[j] = 0.0;
    out.position_rad[j] = kNone;
    last_nm_[j] = blind_kd_nm_s_rad_[j] = 0.0;
  }
}

}  // namespace lithe::guard
