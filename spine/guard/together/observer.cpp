// SPDX-License-Identifier: Apache-2.0
#include "spine/guard/together/observer.hpp"

#include <algorithm>
#include <cmath>

#include "spine/robot/limits/model.hpp"

namespace lithe::guard {
namespace {

constexpr double kLongestStepS = 2.5e-4;
constexpr double kMostSpeed = 3;         // times the speed that is a fault: what a garbled sample can make of the state
constexpr double kHalfRadS = 0.02;       // at this speed half of the dry friction acts
constexpr double kLongestBlockS = 1e-3;  // mass and bias count as constant for so long

unsigned parts(double whole_s, double part_s) {
  return static_cast<unsigned>(std::max(1.0, std::ceil(whole_s / part_s - 1e-6)));
}

}  // namespace

double Told::torque_at(double position_rad, double tracked_rad_s) const LITHE_RT {
  const double added = std::max(damping_nm_s_rad - kd_nm_s_rad, 0.0);
  return std::clamp(felt_nm(position_rad, tracked_rad_s) + added * (balance_rad_s - tracked_rad_s), -most_nm, most_nm);
}

void Observer::configure(const robot::RobotConfig& robot) {
  tree_ = robot::tree_of(robot);
  period_s_ = 1 / robot.rate_hz;
  steps_per_tick_ = parts(period_s_, kLongestStepS);
  step_s_ = period_s_ / steps_per_tick_;
  steps_per_block_ = std::min(steps_per_tick_, static_cast<unsigned>(std::lround(kLongestBlockS / step_s_)));
  steps_per_block_ = std::max(steps_per_block_, 1u);
  lag_s_ = filter_s_ = 0;
  for (std::size_t j = 0; j < tree_.joints(); ++j) {
    const robot::JointConfig& joint = robot.joints[j];
    const robot::DeviceConfig& device = robot.devices[joint.device];
    lag_s_ = std::max(lag_s_, joint.model.torque_lag_s);
    filter_s_ = std::max(filter_s_, 2 / joint.model.velocity_filter_rad_s);
    const double lag = joint.model.torque_lag_s;
    const bool here = device.kind == robot::DeviceKind::cia402;
    joint_[j] = {.divider = device.rate_divider,
                 .computed_here = here,
                 .lag_share = lag > 0 ? 1 - std::exp(-step_s_ / lag) : 1,
                 .filter_share = 1 - std::exp(-step_s_ * joint.model.velocity_filter_rad_s),
                 .damping_nm_s_rad = here ? 0 : joint.safe_kd_nm_s_rad,
                 .most_rad_s = kMostSpeed * joint.velocity_max_rad_s * robot.guard.velocity_overrun,
                 .coulomb_nm = joint.model.coulomb_nm,
                 .slow_rad_s = std::max(kHalfRadS, 2 * step_s_ * joint.model.coulomb_nm / joint.inertia_min_kg_m2)};
  }
  steps_of_lag_ = static_cast<unsigned>(std::lround(lag_s_ / step_s_));
  forget();
}

void Observer::forget() LITHE_RT {
  started_ = false;
  now_ = corrected_ = 0;
  for (std::size_t j = 0; j < tree_.joints(); ++j) {
    given_[j] = acting_[j] = {};
    given_[j].damping_nm_s_rad = acting_[j].damping_nm_s_rad = joint_[j].damping_nm_s_rad;
  }
}

double Observer::bounded(std::size_t j, double rad_s) const LITHE_RT {
  return std::clamp(rad_s, -joint_[j].most_rad_s, joint_[j].most_rad_s);
}

// Dry friction without its jump at rest: a step of it turns no speed round. The brake does not count on it (bias_nm).
double Observer::friction_nm(std::size_t j, double rad_s) const LITHE_RT {
  return joint_[j].coulomb_nm * rad_s / (std::abs(rad_s) + joint_[j].slow_rad_s);
}

void Observer::start(const Seen& seen) LITHE_RT {
  started_ = true;
  JointStates& at = past(0).at;
  at = {};
  for (std::size_t j = 0; j < tree_.joints(); ++j) {
    unseen_s_[j] = 0;
    last_rad_[j] = at.position_rad[j] = seen.fresh[j] ? seen.position_rad[j] : 0;
    last_rad_s_[j] = seen.fresh[j] ? bounded(j, seen.velocity_rad_s[j]) : 0;
    at.velocity_rad_s[j] = at.followed_rad_s[j] = at.tracked_rad_s[j] = last_rad_s_[j];
  }
  past(0).acting = acting_;
}

void Observer::evaluate(const JointStates& at) LITHE_RT {
  tree_.pose(at.position_rad);
  tree_.mass(mass_);
  tree_.torque(at.velocity_rad_s, {}, bias_);
  mechanics::factor(tree_.joints(), mass_, lower_);
}

// With mass and bias as evaluated.
void Observer::step(JointStates& at, const std::array<Told, kMaxJoints>& acting, unsigned steps) LITHE_RT {
  const std::size_t joints = tree_.joints();
  for (unsigned i = 0; i < steps; ++i) {
    JointArray a;
    for (std::size_t j = 0; j < joints; ++j) {
      const double before_nm = at.torque_nm[j];
      const double wanted_nm = acting[j].torque_at(at.position_rad[j], at.tracked_rad_s[j]);
      at.torque_nm[j] += joint_[j].lag_share * (wanted_nm - before_nm);
      a[j] = 0.5 * (before_nm + at.torque_nm[j]) - bias_[j] - friction_nm(j, at.velocity_rad_s[j]);
    }
    mechanics::solve(joints, lower_, a);
    for (std::size_t j = 0; j < joints; ++j) {
      at.position_rad[j] += step_s_ * (at.velocity_rad_s[j] + 0.5 * step_s_ * a[j]);
      at.velocity_rad_s[j] = bounded(j, at.velocity_rad_s[j] + step_s_ * a[j]);
      at.followed_rad_s[j] += joint_[j].filter_share * (at.velocity_rad_s[j] - at.followed_rad_s[j]);
      at.tracked_rad_s[j] += joint_[j].filter_share * (at.followed_rad_s[j] - at.tracked_rad_s[j]);
    }
  }
}

// One tick.
void Observer::advance(JointStates& at, const std::array<Told, kMaxJoints>& acting) LITHE_RT {
  for (unsigned done = 0; done < steps_per_tick_; done += steps_per_block_) {
    evaluate(at);
    step(at, acting, std::min(steps_per_block_, steps_per_tick_ - done));
  }
}

// What was sent acts from the exchange in which its drive was asked.
void Observer::take_over(const Seen& seen, Tick& tick) LITHE_RT {
  tick.asked.fill(false);
  if (was_sent_) {
    const bool old = seen.age_s > 0.5 * period_s_;
    for (std::size_t j = 0; j < tree_.joints(); ++j) {
      if ((exchanges_ - 1) % joint_[j].divider != 0) continue;
      tick.asked[j] = true;
      acting_[j] = given_[j];
      const bool told = old && std::isfinite(seen.position_rad[j]) && std::isfinite(seen.velocity_rad_s[j]);
      acting_[j].balance_rad_s = told ? bounded(j, seen.velocity_rad_s[j]) : last_rad_s_[j];
      if (!joint_[j].computed_here) continue;
      const double at_rad = told ? seen.position_rad[j] : last_rad_[j];
      const double torque_nm = acting_[j].torque_at(at_rad, acting_[j].balance_rad_s);
      acting_[j] = {Pd{.torque_nm = torque_nm}, acting_[j].most_nm, 0, 0};
    }
    was_sent_ = false;
  }
  tick.acting = acting_;
}

void Observer::correct(const Seen& seen, Tick& then) LITHE_RT {
  for (std::size_t j = 0; j < tree_.joints(); ++j) {
    if (!then.asked[j] || !seen.fresh[j]) continue;
    const double off = bounded(j, seen.velocity_rad_s[j]) - then.at.tracked_rad_s[j];
    then.at.position_rad[j] = seen.position_rad[j];
    for (JointArray* speed : {&then.at.velocity_rad_s, &then.at.followed_rad_s, &then.at.tracked_rad_s})
      (*speed)[j] = bounded(j, (*speed)[j] + off);
  }
}

void Observer::rest_unseen(const Seen& seen, JointStates& at) LITHE_RT {
  for (std::size_t j = 0; j < tree_.joints(); ++j) {
    if (seen.fresh[j]) {
      unseen_s_[j] = 0;
      last_rad_[j] = seen.position_rad[j];
      last_rad_s_[j] = bounded(j, seen.velocity_rad_s[j]);
      continue;
    }
    unseen_s_[j] = std::min(unseen_s_[j] + period_s_, 2 * kLongestUnseenS);
    if (unseen_s_[j] < kLongestUnseenS) continue;
    at.position_rad[j] = last_rad_[j];
    at.velocity_rad_s[j] = at.followed_rad_s[j] = at.tracked_rad_s[j] = 0;
  }
}

void Observer::observe(const Seen& seen) LITHE_RT {
  if (!started_ || !all_finite(then_.velocity_rad_s, tree_.joints())) {
    forget();
    start(seen);
  }
  const auto late = static_cast<std::uint64_t>(std::lround(std::clamp(seen.age_s, 0.0, 10.0) / period_s_));
  ++now_;
  Tick& tick = past(now_);
  take_over(seen, tick);
  const std::uint64_t taken = now_ > late ? now_ - late : 0;
  std::uint64_t from = now_ - 1;
  if (now_ > 1 && taken != corrected_ && taken + kPast > now_) {
    corrected_ = taken;
    if (taken == now_) {
      tick.at = past(now_ - 1).at;
      advance(tick.at, past(now_ - 1).acting);
    }
    from = taken;
    correct(seen, past(taken));
  }
  for (std::uint64_t k = from; k < now_; ++k) {
    past(k + 1).at = past(k).at;
    advance(past(k + 1).at, past(k).acting);
  }
  rest_unseen(seen, tick.at);
  next_ = tick.at;
  look_ahead(seen);
}

void Observer::look_ahead(const Seen& seen) LITHE_RT {
  const std::size_t joints = tree_.joints();
  advance(next_, acting_);
  hold_s_ = period_s_;
  for (std::size_t j = 0; j < joints; ++j) {
    felt_nm_[j] = acting_[j].torque_at(next_.position_rad[j], next_.tracked_rad_s[j]);
    const auto gone = static_cast<unsigned>(exchanges_ % joint_[j].divider);
    hold_s_ = std::max(hold_s_, (joint_[j].divider - gone) * period_s_);
  }
  then_ = next_;
  step(then_, acting_, steps_of_lag_);
  ahead_s_ = seen.age_s + period_s_ + lag_s_ + filter_s_;
  evaluate(then_);
  for (std::size_t k = 0; k < joints; ++k) {
    JointArray column{};
    column[k] = 1;
    mechanics::solve(joints, lower_, column);
    for (std::size_t j = 0; j < joints; ++j) inverse_[j][k] = column[j];
  }
}

void Observer::command(std::size_t joint, const Pd& pd, double most_nm) LITHE_RT {
  static_cast<Pd&>(given_[joint]) = pd;
  given_[joint].damping_nm_s_rad = joint_[joint].damping_nm_s_rad;
  given_[joint].most_nm = most_nm;
}

}  // namespace lithe::guard
