// SPDX-License-Identifier: Apache-2.0
#include "spine/step/judge/probation.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "spine/law/clamp_limits.hpp"

namespace lithe::step {
namespace {

using wire::LawFaultKind;

constexpr double kErrorMemoryS = 1.0;
constexpr double kGuardMemoryS = 0.2;  // a setpoint step may saturate a good law for 0.1 s
constexpr double kBusy = law::kTorqueClampLimit.probation, kSlewBusy = law::kSlewClampLimit.probation;
static_assert(law::kPositionClampLimit.probation == kBusy && law::kVelocityClampLimit.probation == kBusy);
constexpr double kCalm = 0.5;       // of these: so little before the commit, and the rest is the new law's
constexpr double kHandedOn = 0.75;  // of these: at most so much counts for the next law of a row
constexpr auto kCatchUpNs = static_cast<std::int64_t>(1e9 * Probation::kCatchUpS);
constexpr std::int64_t kLongestReturnNs = 1'000'000'000;

// The robot moves, or is asked to. A joint that is stopped may have lost its drive, and with it its velocity.
bool in_motion(const Probation::Observed& tick) LITHE_RT {
  const Tick& in = tick.in;
  bool moves = false;
  for (std::uint32_t j = 0; j < in.joints; ++j) {
    moves |= !tick.stopped[j] &&
             (std::abs(in.velocity_rad_s[j]) > Probation::kMovingRadS || tick.asked_rad_s(j) > Probation::kAskedRadS);
  }
  return moves && (in.flags & kSampleStale) == 0;
}

}  // namespace

void Probation::configure(const robot::RobotConfig& robot) {
  forget_error_ = std::exp(-1.0 / (kErrorMemoryS * robot.rate_hz));
  forget_guard_ = std::exp(-1.0 / (kGuardMemoryS * robot.rate_hz));
  forget_slew_ = std::exp(-1.0 / (law::kSlewMemoryS * robot.rate_hz));
  pause_ns_ = std::llround(1e9 * std::max(kPauseS, 3.5 / robot.rate_hz));
  params_ticks_ = static_cast<std::uint32_t>(std::lround(robot.swap.probation_s * robot.rate_hz));
  params_error_ratio_ = robot.swap.probation_error_ratio;
  for (std::uint32_t j = 0; j < robot.joints.size(); ++j)
    tremor_.configure(robot.rate_hz, j, {robot.joints[j].torque_max_nm, robot.joints[j].velocity_max_rad_s});
}

void Probation::start(const law::Resident& law, const Tick& in, bool again) LITHE_RT {
  const bool stands = on();
  terms_ = law.terms;
  law_ = params_ = {};
  if (!law.unproven) {
    if (stands) forget_unproven(in);
    return find(in, again);
  }
  law_.start(terms_.probation_ticks);
  if (!stands) {
    compare_from_here();
  } else {
    if (!again && !(error_ratio_ > 0)) compare_errors_from_here();  // they were not judged: the robot may be far off
    long_steps_ = 0;
    for (double& share : clamped_share_) share = std::min(share, kHandedOn * kBusy);
    for (double& share : slewed_share_) share = std::min(share, kHandedOn * kSlewBusy);
    tremor_.hand_on();
  }
  error_ratio_ = terms_.probation_error_ratio;
  find(in, again);
}

void Probation::start_params(std::uint64_t request_id, const Tick& in) LITHE_RT {
  if (of_law()) {
    law_.start(law_.ticks);
    return find(in, false);
  }
  params_request_id_ = request_id;
  // Several changes in a row are compared with the time before the first of them.
  const bool first = params_.left == 0;
  params_.start(params_ticks_);
  if (first) {
    error_ratio_ = params_error_ratio_;
    compare_from_here();
  }
  find(in, false);
}

void Probation::end_params(const Tick& in) LITHE_RT {
  params_ = {};
  forget_unproven(in);
  find(in, true);
}

double Probation::error_rad(const Tick& in, std::uint32_t j) const LITHE_RT {
  return std::max(0.0, std::abs(tracking_error_rad(in, j)) - std::abs(stepped_rad_[j]));
}

// The largest error on the way, when the joint comes evenly to the setpoint's velocity within kCatchUpS.
double Probation::found_rad(const Tick& in, std::uint32_t j) const LITHE_RT {
  const double drift_rad_s = std::abs(in.velocity_rad_s[j] - in.setpoint_velocity_rad_s[j]);
  return error_rad(in, j) + 0.5 * drift_rad_s * kCatchUpS;
}

double Probation::before_rad(std::uint32_t j) const LITHE_RT { return std::max(error_before_rad_[j], kLeastErrorRad); }

// A joint is beyond the measure. (Of one that is stopped, nothing is known.)
bool Probation::beyond(const Tick& in) const LITHE_RT {
  bool is = false;
  for (std::uint32_t j = 0; j < in.joints; ++j) is |= !stopped_[j] && error_rad(in, j) > error_ratio_ * before_rad(j);
  return is && error_ratio_ > 0;
}

// Every joint is as near to its setpoint as before, and stays there.
bool Probation::is_back(const Tick& in) const LITHE_RT {
  bool is = true;
  for (std::uint32_t j = 0; j < in.joints; ++j) is &= stopped_[j] || found_rad(in, j) <= before_rad(j);
  return is;
}

void Probation::find(const Tick& in, bool again) LITHE_RT {
  if (put_back_ || (!again && beyond(in))) return;
  put_back_ = again && on();
  found_until_ns_ = in.t_ns + kCatchUpNs;
  for (std::uint32_t j = 0; j < in.joints; ++j) found_rad_[j] = stopped_[j] ? 0.0 : found_rad(in, j);
}

void Probation::begin(const Tick& in) LITHE_RT {
  if (!of_law()) return;
  for (std::uint32_t j = 0; j < in.joints; ++j) error_before_rad_[j] = std::max(error_before_rad_[j], found_rad(in, j));
}

void Probation::forget_unproven(const Tick& in) LITHE_RT {
  most_error_rad_ = error_before_rad_;
  clamped_share_ = clamped_before_;
  slewed_share_ = slewed_before_;
  tremor_.restore();
  returning_until_ns_ = in.t_ns + kLongestReturnNs;
}

void Probation::compare_from_here() LITHE_RT {
  long_steps_ = 0;
  compare_errors_from_here();
  clamped_before_ = clamped_share_;
  slewed_before_ = slewed_share_;
  tremor_.start();
}

void Probation::compare_errors_from_here() LITHE_RT {
  const bool found_it_so = last_ns_ < catching_up_ns_;
  for (std::size_t j = 0; j < kMaxJoints; ++j)
    error_before_rad_[j] = found_it_so ? std::max(most_error_rad_[j], paused_rad_[j]) : most_error_rad_[j];
}

Probation::News Probation::watch(const Observed& tick) LITHE_RT {
  News news;
  stepped_rad_ = tick.planned.stepped_rad;
  if (std::exchange(resting_, false)) begin(tick.in);
  remember(tick);
  if (!on()) return news;
  news.kind = find_fault(tick, news.evidence);
  if (news.kind != LawFaultKind::none) return news;
  if (catching_up(tick.in) || beyond(tick.in)) return news;
  const bool moves = in_motion(tick), law_was = law_.unproven(), params_were = params_.unproven();
  news.law_confirmed = law_.count(moves);
  news.params_confirmed = params_.count(moves);
  news.law_unproven = law_.unproven() && !law_was;
  news.params_unproven = params_.unproven() && !params_were;
  return news;
}

LawFaultKind Probation::find_fault(const Observed& tick, Evidence& evidence) const LITHE_RT {
  if (tracking_is_lost(tick.in, evidence)) return LawFaultKind::tracking_lost;
  if (guard_is_busy(tick, evidence)) return LawFaultKind::guard_busy;
  evidence = {.value = 1e-9 * static_cast<double>(tick.law_ns),
              .allowed = 1e-9 * static_cast<double>(terms_.budget_ns)};
  if (long_steps_ >= kMostLong) return LawFaultKind::overran;
  evidence = {.tremor = tremor_.find(tick.in.joints)};
  const law::Tremor::Finding& finding = evidence.tremor;
  if (finding.kind == law::Tremor::Finding::Kind::chatter) return LawFaultKind::chattering;
  if (finding.kind == law::Tremor::Finding::Kind::oscillation) return LawFaultKind::oscillating;
  return LawFaultKind::none;
}

bool Probation::tracking_is_lost(const Tick& in, Evidence& evidence) const LITHE_RT {
  if (!(error_ratio_ > 0) || catching_up(in)) return false;
  for (std::uint32_t j = 0; j < in.joints; ++j) {
    const double found = in.t_ns < found_until_ns_ ? found_rad_[j] : 0.0;
    const double allowed = std::max(error_ratio_ * before_rad(j), found);
    evidence = {.joint = j, .value = error_rad(in, j), .allowed = allowed};
    if (evidence.value > allowed) return true;
  }
  return false;
}

bool Probation::guard_is_busy(const Observed& tick, Evidence& evidence) const LITHE_RT {
  for (std::uint32_t j = 0; j < tick.in.joints; ++j) {
    evidence = {.joint = j, .value = clamped_share_[j], .allowed = kBusy, .clamped = tick.clamped[j]};
    if (clamped_share_[j] > kBusy && clamped_before_[j] < kCalm * kBusy) return true;
    evidence = {.joint = j, .value = slewed_share_[j], .allowed = kSlewBusy, .clamped = Probation::kSlewed};
    if (slewed_share_[j] > kSlewBusy && slewed_before_[j] < kCalm * kSlewBusy) return true;
  }
  return false;
}

void Probation::see_pauses(const Observed& tick) LITHE_RT {
  const Tick& in = tick.in;
  const bool unsampled = (in.flags & kSampleStale) != 0 && in.sample_age_s * 1e9 >= static_cast<double>(pause_ns_);
  if ((last_ns_ > 0 && in.t_ns - last_ns_ >= pause_ns_) || unsampled || tick.soft_start) {
    if (!catching_up(in)) paused_rad_.fill(0.0);
    catching_up_ns_ = in.t_ns + kCatchUpNs;
  }
  last_ns_ = in.t_ns;
  stopped_ = tick.stopped;
  if (!beyond(in)) put_back_ = false;
  if (!on() && is_back(in)) returning_until_ns_ = 0;
}

void Probation::remember(const Observed& tick) LITHE_RT {
  see_pauses(tick);
  const bool counts = !catching_up(tick.in), returns = !on() && tick.in.t_ns < returning_until_ns_;
  for (std::uint32_t j = 0; j < tick.in.joints; ++j) {
    const double off_rad = error_rad(tick.in, j);
    if (!counts && !on() && !returns) paused_rad_[j] = std::max(paused_rad_[j], off_rad);
    const bool excused = on() && error_ratio_ > 0 && off_rad > error_ratio_ * before_rad(j);
    if (counts && !returns && !excused) most_error_rad_[j] = std::max(off_rad, most_error_rad_[j] * forget_error_);
    const double clamped = (tick.clamped[j] & kClamped) != 0 ? 1.0 : 0.0;
    const double slewed = (tick.clamped[j] & (kSlewed | kBraked)) == kSlewed ? 1.0 : 0.0;
    if (!returns && !(excused && counts)) {
      clamped_share_[j] = clamped + (clamped_share_[j] - clamped) * forget_guard_;
      slewed_share_[j] = slewed + (slewed_share_[j] - slewed) * forget_slew_;
    }
    const law::SetpointSteps steps{tick.planned.steps, tick.planned.step_rad_s[j]};
    tick.stopped[j] || returns ? tremor_.skip(j) : tremor_.see(tick.in, j, tick.torque_nm[j], steps);
  }
  const bool too_long = terms_.budget_ns > 0 && tick.law_ns > terms_.budget_ns;
  long_steps_ = too_long ? long_steps_ + 1 : 0;
}

void Probation::rest(std::uint32_t joints, bool fault) LITHE_RT {
  resting_ = true;
  for (std::uint32_t j = 0; j < joints; ++j) {
    const double kept = fault ? 0.0 : forget_error_, kept_guard = fault ? 0.0 : forget_guard_;
    const double kept_slew = fault ? 0.0 : forget_slew_;
    most_error_rad_[j] *= kept;
    error_before_rad_[j] *= kept;
    clamped_share_[j] *= kept_guard;
    clamped_before_[j] *= kept_guard;
    slewed_share_[j] *= kept_slew;
    slewed_before_[j] *= kept_slew;
    tremor_.rest(j, fault);
  }
  paused_rad_.fill(0.0);
}

}  // namespace lithe::step
