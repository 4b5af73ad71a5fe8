// SPDX-License-Identifier: Apache-2.0
// Finds the faults of this tick, the groups that they stop, and each group's rung.
#include <array>
#include <cmath>

#include "spine/guard/guard.hpp"

namespace lithe::guard {
namespace {

using wire::Fault;
using wire::Mode;
namespace bit = wire::joint_status;

// Plausibility limits: a sample beyond them is not a measurement, and products with it could overflow.
constexpr double kAbsurd = 1.0e6;

// With several faults at once, the first of this list is reported.
constexpr std::array kWorstFirst{Fault::drive_fault,    Fault::drive_watchdog, Fault::drive_conflict,
                                 Fault::drive_garbled,  Fault::drive_lost,     Fault::drive_not_homed,
                                 Fault::sample_stale,   Fault::law_not_finite, Fault::position_limit,
                                 Fault::velocity_limit, Fault::recover_failed, Fault::brain_stale};

Fault worse(Fault a, Fault b) LITHE_RT {
  for (const Fault each : kWorstFirst)
    if (a == each || b == each) return each;
  return Fault::none;
}

bool law_runs(Mode mode) LITHE_RT { return mode == Mode::active || mode == Mode::hold; }

// Latches a new fault.
bool latches(Mode mode) LITHE_RT { return law_runs(mode) || mode == Mode::recover; }

bool is_sane(const Input& in, std::size_t j) LITHE_RT {
  return std::abs(in.position_rad[j]) < kAbsurd && std::abs(in.velocity_rad_s[j]) < kAbsurd;
}

}  // namespace

void Guard::forget_faults() LITHE_RT {
  group_.fill({});
  for (Joint& joint : joint_) joint.fault = Fault::none;
  any_stopped_ = false;
}

// The worst fault of this tick, without earlier faults of groups that the robot continues without.
Fault Guard::find_fault(const Input& in, Verdict& verdict) LITHE_RT {
  for (std::size_t g = 0; g < groups_; ++g) group_[g].news = false;
  const bool too_late = in.stale_ticks >= rules_.late_ticks_to_stop;
  const Fault of_joints = fault_of_joints(in, too_late);
  const Fault of_all = fault_of_robot(in, too_late, verdict.flags);
  bool all_stopped = true;
  Fault news = Fault::none;
  for (std::size_t g = 0; g < groups_; ++g) {
    all_stopped = all_stopped && group_[g].fault != Fault::none;
    if (group_[g].news) news = worse(news, group_[g].fault);
  }
  const bool joints_stop_all =
      of_joints != Fault::none && (!rules_.others_go_on || all_stopped || in.mode == Mode::recover);
  verdict.use_safe_law = of_all != Fault::none || joints_stop_all || in.mode == Mode::safe_stop;
  if (any_stopped_ && !verdict.use_safe_law) verdict.flags |= wire::telemetry_flag::kGroupStopped;
  if (news == Fault::none && of_all == Fault::none && verdict.use_safe_law) news = of_joints;
  return verdict.use_safe_law ? worse(of_all, news) : news;
}

// Also determines which samples are usable.
Fault Guard::fault_of_joints(const Input& in, bool too_late) LITHE_RT {
  Fault worst = Fault::none;
  for (std::size_t j = 0; j < joints_; ++j) {
    Joint& joint = joint_[j];
    // While the whole sample is late, its age says so. A drive without an answer may be accepted for long.
    constexpr std::uint32_t kMostUnseen = 1000;
    if ((in.joint_status[j] & bit::kFresh) != 0)
      joint.unseen_ticks = 0;
    else if (in.stale_ticks == 0)
      joint.unseen_ticks = std::min(joint.unseen_ticks + 1, kMostUnseen);
    joint.usable = !too_late && is_sane(in, j) && (in.joint_status[j] & (bit::kLost | bit::kConflict)) == 0;
    const Fault fault = fault_of_joint(in, j);
    if (fault == Fault::none) continue;
    worst = worse(worst, fault);
    const bool told = joint.fault != Fault::none;
    if (!told && (latches(in.mode) || in.mode == Mode::safe_stop)) joint.fault = fault;
    if (latches(in.mode)) latch(joint, j, fault);
  }
  return worst;
}

Fault Guard::fault_of_joint(const Input& in, std::size_t j) const LITHE_RT {
  const std::uint32_t status = in.joint_status[j];
  const Limits& limit = joint_[j].limit;
  if ((status & bit::kFault) != 0) return Fault::drive_fault;
  if ((status & bit::kWatchdog) != 0) return Fault::drive_watchdog;
  if ((status & bit::kConflict) != 0) return Fault::drive_conflict;
  if ((status & bit::kLost) != 0) return (status & bit::kGarbled) != 0 ? Fault::drive_garbled : Fault::drive_lost;
  if (limit.must_be_homed && (status & bit::kNotHomed) != 0) return Fault::drive_not_homed;
  if (!is_sane(in, j)) return Fault::sample_stale;
  const bool beyond = in.position_rad[j] > limit.position_max_rad + limit.overrun_rad ||
                      in.position_rad[j] < limit.position_min_rad - limit.overrun_rad;
  if (beyond && in.mode != Mode::recover) return Fault::position_limit;
  if (std::abs(in.velocity_rad_s[j]) > limit.velocity_fault_rad_s) return Fault::velocity_limit;
  return in.mode == Mode::recover && recovery_.stuck(j) ? Fault::recover_failed : Fault::none;
}

// The first fault of a group is kept.
void Guard::latch(const Joint& joint, std::size_t j, Fault fault) LITHE_RT {
  Group& group = group_[joint.group];
  if (group.fault != Fault::none) return;
  group.fault = fault;
  group.joint = static_cast<std::uint8_t>(j);
  group.news = any_stopped_ = true;
}

// Faults of the whole robot.
Fault Guard::fault_of_robot(const Input& in, bool too_late, std::uint32_t& flags) const LITHE_RT {
  if (in.stale_ticks > 0) flags |= wire::telemetry_flag::kSampleStale;
  const bool brain_stale = in.brain_age_ns < 0 || in.brain_age_ns > rules_.brain_stale_ns;
  if (brain_stale) flags |= wire::telemetry_flag::kBrainStale;
  const bool finite = !law_runs(in.mode) || not_finite_at(in.effort) == kMaxJoints;
  if (!finite) flags |= wire::telemetry_flag::kNotFinite;
  if (too_late) return Fault::sample_stale;
  if (!finite) return Fault::law_not_finite;
  const bool needs_brain = rules_.stop_when_brain_stale && in.mode != Mode::recover;
  return brain_stale && needs_brain ? Fault::brain_stale : Fault::none;
}

std::size_t Guard::not_finite_at(const Effort& effort) const LITHE_RT {
  for (std::size_t j = 0; j < joints_; ++j) {
    // x - x is 0 for every finite x and NaN for the others; a position may be absent (NaN) but not infinite.
    const double sum = (effort.torque_nm[j] - effort.torque_nm[j]) +
                       (effort.velocity_rad_s[j] - effort.velocity_rad_s[j]) +
                       (effort.kp_nm_rad[j] - effort.kp_nm_rad[j]) + (effort.kd_nm_s_rad[j] - effort.kd_nm_s_rad[j]);
    const bool finite = sum == 0.0 && !std::isinf(effort.position_rad[j]);
    if (!finite && !stopped(j)) return j;
  }
  return kMaxJoints;
}

// The rung of each group. For `brake`, joints without usable samples do not count as moving: the drive damps them, and
// it may never be known that they are at rest. For `off`, every joint must have been measured at rest for the whole
// time, because a moving joint could fall.
void Guard::descend_all(const Input& in, bool all) LITHE_RT {
  std::array<bool, kMaxJoints> moves{}, unseen{};
  for (std::size_t j = 0; j < joints_; ++j) {
    const std::size_t g = joint_[j].group;
    moves[g] = moves[g] || (joint_[j].usable && std::abs(in.velocity_rad_s[j]) >= kAtRestRadS);
    unseen[g] = unseen[g] || !joint_[j].usable;
  }
  for (std::size_t g = 0; g < groups_; ++g) {
    Group& group = group_[g];
    const bool latched = in.mode == Mode::safe_stop || (group.fault != Fault::none && !group.news);
    if (latched) {
      descend(group, !moves[g], !moves[g] && !unseen[g]);
    } else {
      group.rung = all || group.fault != Fault::none ? Rung::safe_law : Rung::law;
      group.ticks_at_rest = group.ticks_seen_at_rest = 0;
    }
  }
}

void Guard::descend(Group& group, bool at_rest, bool seen_at_rest) LITHE_RT {
  const bool braked = rules_.brake_after_ticks != 0 && group.ticks_at_rest >= rules_.brake_after_ticks;
  const bool off = rules_.off_after_ticks != 0 && group.ticks_seen_at_rest >= rules_.off_after_ticks;
  // A push does not leave the rung `brake`.
  group.ticks_at_rest = at_rest || braked ? group.ticks_at_rest + 1 : 0;
  group.ticks_seen_at_rest = seen_at_rest || off ? group.ticks_seen_at_rest + 1 : 0;
  group.rung = off ? Rung::off : braked ? Rung::brake : Rung::safe_law;
}

}  // namespace lithe::guard
