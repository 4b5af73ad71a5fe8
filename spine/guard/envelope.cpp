// SPDX-License-Identifier: Apache-2.0
#include "spine/guard/envelope.hpp"

#include <algorithm>
#include <cmath>

namespace lithe::guard {
namespace {

constexpr int kBisections = 6;  // to 1/64 of what slew leaves
// Of the way from the velocity limit to the velocity that is a fault: as far as the guard lets a joint go.
constexpr double kSpeedShare = 0.9;
// After this many time constants a first-order lag has settled to 86 %.
constexpr double kLags = 2;
// A torque acts longer than the reaction time by what a Transport thread, an exchange that is late and the drive's
// estimate of the velocity add. With buckets of one or two ticks, no bound of tests/limits was exceeded with 3, some
// with 2.
constexpr std::size_t kMoreTicks = 6;
// Torques are kept for samples of this age; for an older one only these count.
constexpr std::uint32_t kMostLateTicks = 40;

}  // namespace

void Envelope::configure(const robot::RobotConfig& robot, const robot::JointConfig& joint) {
  brakes_ = robot::brakes_of(joint);
  position_min_rad_ = joint.position_min_rad;
  position_max_rad_ = joint.position_max_rad;
  speed_max_rad_s_ = joint.velocity_max_rad_s * (1 + kSpeedShare * (robot.guard.velocity_overrun - 1));
  reaction_s_ = robot::reaction_s(robot, joint);
  period_s_ = robot::drive_period_s(robot, joint);
  damping_nm_s_rad_ = joint.safe_kd_nm_s_rad;
  // The damping that the drive adds is balanced at the speed of a sample, and takes from the braking what changed
  // since.
  if (on()) brakes_.load_nm += damping_nm_s_rad_ * brakes_.deceleration_rad_s2() * reaction_s_;
  brakes_.load_nm = std::min(brakes_.load_nm, 0.95 * brakes_.torque_max_nm);
  const double acts_for_s = reaction_s_ + (kLags - 1) * joint.drive_lag_s;
  acts_for_ticks_ = static_cast<std::size_t>(std::ceil(acts_for_s * robot.rate_hz)) + kMoreTicks;
  const std::size_t ticks = acts_for_ticks_ + std::min(robot.spine.late_ticks_to_stop, kMostLateTicks);
  ticks_per_bucket_ = (ticks + kBuckets - 3) / (kBuckets - 2);
  forget();
}

void Envelope::forget() LITHE_RT {
  past_.fill({});
  bucket_ = ticks_left_ = 0;
}

void Envelope::in_flight(double least_nm, double most_nm) LITHE_RT {
  if (ticks_left_ == 0) {
    ticks_left_ = ticks_per_bucket_ - 1;
    bucket_ = (bucket_ + 1) % kBuckets;
    past_[bucket_] = {least_nm, most_nm};
    return;
  }
  --ticks_left_;
  past_[bucket_].least_nm = std::min(past_[bucket_].least_nm, least_nm);
  past_[bucket_].most_nm = std::max(past_[bucket_].most_nm, most_nm);
}

Envelope::Range Envelope::flying(std::uint32_t age_ticks) const LITHE_RT {
  // One more for the newest, which is not full, and one for the rest of the division.
  const std::size_t count = std::min((age_ticks + acts_for_ticks_) / ticks_per_bucket_ + 2, kBuckets);
  Range all = past_[bucket_];
  for (std::size_t i = 1; i < count; ++i) {
    const Range& each = past_[(bucket_ + kBuckets - i) % kBuckets];
    all.least_nm = std::min(all.least_nm, each.least_nm);
    all.most_nm = std::max(all.most_nm, each.most_nm);
  }
  return all;
}

// kp pulls outwards what moves inwards, kd what slows down.
Envelope::Drift Envelope::drift(const Measured& now, double torque_nm, double kp_nm_rad, double kd_nm_s_rad) const
    LITHE_RT {
  if (!on()) return {};
  const double time_s = now.age_s + reaction_s_;
  const double kd = std::max(kd_nm_s_rad, damping_nm_s_rad_) / brakes_.inertia_min_kg_m2;
  const double v = now.velocity_rad_s;
  return {.down_nm = time_s * (kp_nm_rad * std::max(v, 0.0) + kd * std::max(brakes_.load_nm + torque_nm, 0.0)),
          .up_nm = time_s * (kp_nm_rad * std::max(-v, 0.0) + kd * std::max(brakes_.load_nm - torque_nm, 0.0))};
}

robot::Stop Envelope::stop(const Measured& now, const Range& flying, double torque_nm, bool up) const LITHE_RT {
  const double side = up ? 1 : -1;
  return robot::stop_of(brakes_, side * now.velocity_rad_s,
                        {up ? flying.most_nm : -flying.least_nm, now.age_s + reaction_s_},
                        {side * torque_nm, period_s_});
}

double Envelope::way_left_rad(const Measured& now, bool up) const LITHE_RT {
  return std::max(up ? position_max_rad_ - now.position_rad : now.position_rad - position_min_rad_, 0.0);
}

bool Envelope::stops(const Measured& now, const Range& flying, double torque_nm, bool up) const LITHE_RT {
  const robot::Stop found = stop(now, flying, torque_nm, up);
  return found.way_rad <= way_left_rad(now, up) && found.peak_rad_s <= speed_max_rad_s_;
}

// From `torque_nm` towards `far_nm` until it stops.
double Envelope::restrict(const Measured& now, const Range& flying, double far_nm, double torque_nm, bool up) const
    LITHE_RT {
  if (stops(now, flying, torque_nm, up)) return torque_nm;
  double good = far_nm, bad = torque_nm;
  if (!stops(now, flying, good, up)) return good;
  for (int i = 0; i < kBisections; ++i) {
    const double middle = 0.5 * (good + bad);
    (stops(now, flying, middle, up) ? good : bad) = middle;
  }
  return good;
}

// When no torque stops the joint on both sides: the torque with the same overrun on both sides.
double Envelope::balance(const Measured& now, const Range& flying, double least_nm, double most_nm) const LITHE_RT {
  for (int i = 0; i < kBisections; ++i) {
    const double middle = 0.5 * (least_nm + most_nm);
    const double above = stop(now, flying, middle, true).way_rad - way_left_rad(now, true);
    const double below = stop(now, flying, middle, false).way_rad - way_left_rad(now, false);
    (above > below ? most_nm : least_nm) = middle;
  }
  return 0.5 * (least_nm + most_nm);
}

double Envelope::bound_one(const Measured& now, double least_nm, double wanted_nm, double most_nm, bool up) const
    LITHE_RT {
  return on() ? restrict(now, flying(now.age_ticks), up ? least_nm : most_nm, wanted_nm, up) : wanted_nm;
}

double Envelope::bound(const Measured& now, double least_nm, double wanted_nm, double most_nm) const LITHE_RT {
  if (!on()) return wanted_nm;
  const Range all = flying(now.age_ticks);
  const bool up = now.velocity_rad_s > 0;
  const double other = restrict(now, all, up ? most_nm : least_nm, wanted_nm, !up);
  const double bounded = restrict(now, all, up ? least_nm : most_nm, other, up);
  if (bounded == wanted_nm || stop(now, all, bounded, !up).way_rad <= way_left_rad(now, !up)) return bounded;
  return balance(now, all, least_nm, most_nm);
}

}  // namespace lithe::guard
