// SPDX-License-Identifier: Apache-2.0
#include "spine/step/judge/watch.hpp"

#include <cmath>
#include <utility>

#include "spine/law/clamp_limits.hpp"

namespace lithe::step {
namespace {

using wire::LawFaultKind;

// A load that the file does not know of, and one that would leave nothing of the torque to judge.
constexpr double kLeastLoadShare = 0.1, kMostLoadShare = 0.9;  // of torque_max_nm
constexpr double kLimpShare = 0.05;                            // of the largest torque of the reference: almost none
constexpr double kPushedShare = 0.25, kLimpTicks = 0.9;        // of the ticks of a window
// Correlation of torque and velocity error. In an oscillation that a law keeps up, the torque is about a quarter of a
// period ahead (0); delays of the measurement up to a twelfth of a period leave it above this.
constexpr double kBraking = -0.5;
// A setpoint that asks for this much, or as much as in the reference, is no reason for a larger error.
constexpr double kUsualRadS = 0.5, kUsualRadS2 = 5.0;

}  // namespace

void Watch::configure(const robot::RobotConfig& robot) {
  window_ticks_ = static_cast<std::uint32_t>(std::max(std::lround(kWindowS * robot.rate_hz), 1L));
  own_windows_ = static_cast<std::uint32_t>(std::lround(kOwnReferenceS / kWindowS));
  joints_ = static_cast<std::uint32_t>(std::min(robot.joints.size(), kMaxJoints));
  for (std::uint32_t j = 0; j < joints_; ++j) {
    const robot::JointConfig& joint = robot.joints[j];
    joint_[j].torque_max_nm = joint.torque_max_nm;
    joint_[j].load_nm =
        std::clamp(joint.load_max_nm, kLeastLoadShare * joint.torque_max_nm, kMostLoadShare * joint.torque_max_nm);
    joint_[j].loop = robot::loop_of(robot, joint);
  }
}

void Watch::begin(const law::Resident& law, std::int64_t now_ns) LITHE_RT {
  law_id_ = law.law_id;
  error_ratio_ = law.terms.probation_error_ratio;
  own_ = &references_[law.index % law::kResidents];
  if (own_->law_id != law_id_) *own_ = {.law_id = law_id_};
  from_ns_ = now_ns + static_cast<std::int64_t>(1e9 * Probation::kCatchUpS);
  score_ = {};
  suspects_ = was_on_probation_ = false;
}

Watch::News Watch::see(const law::Resident& law, const Probation::Observed& tick, const Probation& probation) LITHE_RT {
  if (law.law_id != law_id_) begin(law, tick.in.t_ns);
  const bool on_probation = probation.on(), was_on = std::exchange(was_on_probation_, on_probation);
  if (on_probation && !was_on && own_->closed) *own_ = {.law_id = law_id_};  // new parameters
  if (!on_probation && own_->windows >= (was_on ? 1 : own_windows_)) own_->closed = true;
  if (tick.in.t_ns < from_ns_ || probation.catching_up(tick.in)) {
    ticks_ = 0;
    window_ = {};
    return {};
  }
  for (std::uint32_t j = 0; j < joints_; ++j) add(tick, j);
  if (++ticks_ < window_ticks_) return {};
  const News news = end_window(probation);
  for (std::uint32_t j = 0; j < joints_; ++j) before_[j] = std::exchange(window_[j], {}).asked;
  ticks_ = 0;
  return news;
}

void Watch::add(const Probation::Observed& tick, std::uint32_t j) LITHE_RT {
  const Tick& in = tick.in;
  const double error = tracking_error_rad(in, j), torque_nm = tick.torque_nm[j], felt_nm = in.torque_nm[j];
  const double speed_rad_s = in.velocity_rad_s[j] - in.setpoint_velocity_rad_s[j];
  if (tick.stopped[j] || !std::isfinite(error + torque_nm + felt_nm + speed_rad_s)) return;
  Window& now = window_[j];
  now.asked.rad_s = std::max(now.asked.rad_s, tick.asked_rad_s(j));
  now.asked.rad_s2 = std::max(now.asked.rad_s2, std::abs(in.setpoint_acceleration_rad_s2[j]));
  const double off_rad = std::max(0.0, std::abs(error) - std::abs(tick.planned.stepped_rad[j])),
               side = error > 0 ? 1.0 : -1.0;
  if (off_rad > far_rad(j)) {
    const bool away = side * push_of(tick, j) < -1;
    const bool comes_nearer = side * in.velocity_rad_s[j] > Probation::kMovingRadS;
    const bool limp = std::abs(torque_nm) < kLimpShare * own_->joints[j].most_nm;
    now.pushed += away && !comes_nearer ? 1 : 0;
    now.limp += limp && off_rad > far_rad(j) * asked_more(j) ? 1 : 0;
  }
  now.ticks += 1;
  now.error_rad += off_rad;
  now.most_error_rad = std::max(now.most_error_rad, off_rad);
  now.toward_nm += side * torque_nm;
  now.most_nm = std::max(now.most_nm, std::abs(torque_nm));
  now.felt_nm += felt_nm;
  now.speed_rad_s += speed_rad_s;
  now.work += felt_nm * speed_rad_s;
  now.felt_squared += felt_nm * felt_nm;
  now.speed_squared += speed_rad_s * speed_rad_s;
}

// What the law asks the joint to do, of what it may ask without reason: beyond 1 (or -1) it moves the joint that way.
double Watch::push_of(const Probation::Observed& tick, std::uint32_t j) const LITHE_RT {
  switch (joint_[j].loop) {
    case robot::DriveLoop::velocity:
      return tick.effort.velocity_rad_s[j] / Probation::kMovingRadS;
    case robot::DriveLoop::position:
      return (tick.effort.position_rad[j] - tick.in.position_rad[j]) / Probation::kLeastErrorRad;
    default:
      return tick.torque_nm[j] / joint_[j].load_nm;
  }
}

// Beyond this error a joint is far from its setpoint.
double Watch::far_rad(std::uint32_t j) const LITHE_RT {
  constexpr double kUsualRatio = 3;  // where errors are not judged
  return (error_ratio_ > 0 ? error_ratio_ : kUsualRatio) *
         std::max(own_->joints[j].error_rad, Probation::kLeastErrorRad);
}

// How much more the setpoint asks than it did in the reference; at least 1.
double Watch::asked_more(std::uint32_t j) const LITHE_RT {
  const Asked &own = own_->joints[j].asked, &now = window_[j].asked, &before = before_[j];
  return std::max({1.0, std::max(now.rad_s, before.rad_s) / std::max(own.rad_s, kUsualRadS),
                   std::max(now.rad_s2, before.rad_s2) / std::max(own.rad_s2, kUsualRadS2)});
}

// The window's torque opposes the velocity error: the law brakes what something else moves.
bool Watch::brakes(const Window& now) LITHE_RT {
  const double n = now.ticks, covariance = now.work - now.felt_nm * now.speed_rad_s / n;
  const double of_torque = now.felt_squared - now.felt_nm * now.felt_nm / n;
  const double of_speed = now.speed_squared - now.speed_rad_s * now.speed_rad_s / n;
  return covariance < kBraking * std::sqrt(std::max(of_torque * of_speed, 0.0));
}

std::uint32_t Watch::judge(const Probation& probation, std::uint32_t j) const LITHE_RT {
  const Window& now = window_[j];
  if (2 * now.ticks < window_ticks_) return 0;
  const double ticks = now.ticks;
  const auto kind = probation.tremor().find_at(j).kind;
  const bool trembles = kind != law::Tremor::Finding::Kind::none;
  const bool chatters = kind == law::Tremor::Finding::Kind::chatter;
  const bool is_shaken_now = trembles && !chatters && brakes(now);
  const double most_slewed = law::kSlewClampLimit.probation * (own_->closed ? 1.0 : 0.5);
  const bool judged = error_ratio_ > 0, by_torque = joint_[j].loop == robot::DriveLoop::torque;
  std::uint32_t bad = 0;
  const auto put = [&bad](Criterion criterion, bool is) LITHE_RT { bad |= is ? 1u << criterion : 0u; };
  put(pushes_away, judged && now.pushed >= kPushedShare * ticks);
  put(gives_no_torque, judged && by_torque && now.limp >= kLimpTicks * ticks);
  put(shakes, trembles && !is_shaken_now);
  put(slewed, by_torque && probation.slewed_share(j) > most_slewed && !(asked_more(j) > 1));
  put(is_shaken, is_shaken_now);
  put(is_far, judged && bad == 0 && now.error_rad > ticks * far_rad(j) * asked_more(j));
  return bad;
}

void Watch::learn(std::uint32_t j, std::uint32_t bad) LITHE_RT {
  const Window& now = window_[j];
  if (now.ticks == 0) return;
  OfJoint& own = own_->joints[j];
  own.did |= bad & ~(1u << is_far);
  own.error_rad = std::max(own.error_rad, now.error_rad / now.ticks);
  own.most_nm = std::max(own.most_nm, now.most_nm);
  own.asked.rad_s = std::max(own.asked.rad_s, now.asked.rad_s);
  own.asked.rad_s2 = std::max(own.asked.rad_s2, now.asked.rad_s2);
}

Watch::News Watch::end_window(const Probation& probation) LITHE_RT {
  bool calm = true;
  for (std::uint32_t j = 0; j < joints_; ++j) {
    const std::uint32_t bad = judge(probation, j);
    if (!own_->closed) learn(j, bad);
    bad_[j] = own_->closed ? bad & ~own_->joints[j].did : 0;
    calm = calm && bad_[j] == 0;
    for (std::uint32_t c = 0; c < kCriteria; ++c) {
      std::uint32_t& score = score_[j][c];
      score = (bad_[j] >> c & 1) != 0 ? std::min(score + 1, kActScore) : score - std::min(score, 1u);
    }
  }
  if (!own_->closed) ++own_->windows;
  quiet_ = calm ? quiet_ + 1 : 0;
  suspects_ = suspects_ && quiet_ < kActScore;
  if (const News fault = find(kActScore, kOfTheLaw, probation); fault.found.kind != LawFaultKind::none) return fault;
  return suspects_ ? News{} : find(kAlarmScore, kCriteria, probation);
}

// The first of so many criteria with this score, at a joint whose last window was bad, too.
Watch::News Watch::find(std::uint32_t score, std::uint32_t criteria, const Probation& probation) LITHE_RT {
  for (std::uint32_t c = 0; c < criteria; ++c) {
    for (std::uint32_t j = 0; j < joints_; ++j) {
      if (score_[j][c] < score || (bad_[j] >> c & 1) == 0) continue;
      suspects_ = true;
      News news = tell(static_cast<Criterion>(c), j, probation);
      news.is_laws_fault = score == kActScore;
      return news;
    }
  }
  return {};
}

Watch::News Watch::tell(Criterion criterion, std::uint32_t j, const Probation& probation) const LITHE_RT {
  const Window& now = window_[j];
  News news;
  news.toward_nm = now.toward_nm / now.ticks;
  for (std::uint32_t k = 0; k < joints_; ++k) news.any_far |= window_[k].error_rad > window_[k].ticks * far_rad(k);
  Probation::Evidence& evidence = news.found.evidence;
  evidence = {.joint = j, .value = now.most_error_rad, .allowed = far_rad(j)};
  switch (criterion) {
    case pushes_away:
      news.found.kind = LawFaultKind::pushes_away;
      break;
    case gives_no_torque:
      news.found.kind = LawFaultKind::gives_no_torque;
      break;
    case shakes:
    case is_shaken:
      evidence.tremor = probation.tremor().find_at(j);
      news.found.kind = evidence.tremor.kind == law::Tremor::Finding::Kind::chatter ? LawFaultKind::chattering
                                                                                    : LawFaultKind::oscillating;
      break;
    case slewed:
      evidence.value = probation.slewed_share(j);
      evidence.allowed = law::kSlewClampLimit.probation;
      evidence.clamped = Probation::kSlewed;
      news.found.kind = LawFaultKind::guard_busy;
      break;
    case is_far:
      evidence.allowed = far_rad(j) * asked_more(j);
      news.found.kind = LawFaultKind::tracking_lost;
      break;
  }
  return news;
}

}  // namespace lithe::step
