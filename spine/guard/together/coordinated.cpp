// SPDX-License-Identifier: Apache-2.0
#include "spine/guard/together/coordinated.hpp"

#include <algorithm>
#include <cmath>

#include "spine/robot/limits/model.hpp"

namespace lithe::guard {
namespace {

constexpr double kKeptFreeRad = 0.03;  // before a position limit
constexpr double kUnsureRadS = 0.3;    // the speed at then() may be wrong by this
constexpr double kSpeedKept = 0.97;    // of the speed that is kept
constexpr double kHardest = 10;        // times the allotted deceleration, for a joint that needs it and torques reach
constexpr double kHarder = 1.5;        // the part of it that all joints get
constexpr double kGentle = 0.5;        // of the allotted deceleration, for a joint that has room
constexpr double kSlowRadS = 0.5;      // below it a joint may wait for the others, see slow_rad_s()
constexpr double kBackRadS = 0.5;      // beyond a limit: back, at most so fast
constexpr double kNowShare = 0.8;      // of what the torques permit in this pose and for these directions
constexpr double kNowMost = 3;         // times the allotted deceleration; pose and directions change on the way
constexpr double kTiny = 1e-9;

// Constant acceleration, then a line down to a braking deceleration, then that: how far, and how fast at most.
struct Way {
  double x, v;
  double farthest = x, fastest = v;

  void go(double from, double to, double time_s) LITHE_RT {
    if (time_s <= 0) return;
    const double jerk = (from - to) / time_s, end = v + 0.5 * (from + to) * time_s;
    if (from > 0 && to < 0) fastest = std::max(fastest, v + 0.5 * from * from / jerk);
    if (v > 0 && end < 0) {  // it turns round in between
      const double inside = std::max(from * from + 2 * jerk * v, 0.0);
      const double s = std::abs(jerk) < kTiny ? -v / from : (from + std::sqrt(inside)) / jerk;
      if (s > 0 && s < time_s) farthest = std::max(farthest, x + (v + (0.5 * from - jerk * s / 6) * s) * s);
    }
    x += (v + (0.5 * from - jerk * time_s / 6) * time_s) * time_s;
    v = end;
    farthest = std::max(farthest, x);
    fastest = std::max(fastest, v);
  }
  void stop(double deceleration) LITHE_RT {
    if (v > 0) farthest = std::max(farthest, x + 0.5 * v * v / deceleration);
  }
};

}  // namespace

void Coordinated::configure(const robot::RobotConfig& robot) {
  observer_.configure(robot);
  joints_ = robot.joints.size();
  error_ = robot.model.error;
  // The speed that is a fault, less a tenth of its distance from the limit.
  const double overrun = 1 + 0.9 * (robot.guard.velocity_overrun - 1);
  for (std::size_t j = 0; j < joints_; ++j) {
    const robot::JointConfig& joint = robot.joints[j];
    const unsigned divider = robot.devices[joint.device].rate_divider;
    joint_[j] = {.min_rad = joint.position_min_rad,
                 .max_rad = joint.position_max_rad,
                 .speed_rad_s = kSpeedKept * joint.velocity_max_rad_s * overrun,
                 .torque_nm = joint.torque_max_nm,
                 .slew_nm_s = joint.torque_slew_nm_s,
                 .slew_step_nm = joint.torque_slew_nm_s / robot.rate_hz * divider,
                 .allotted_rad_s2 = joint.model.allotted_rad_s2,
                 .kp_most_nm_rad = std::min(joint.kp_max_nm_rad, joint.model.kp_most_nm_rad),
                 .kd_most_nm_s_rad =
                     std::min(joint.kd_max_nm_s_rad, std::max(joint.safe_kd_nm_s_rad, joint.model.kd_most_nm_s_rad))};
  }
}

JointArray Coordinated::acceleration(const JointArray& torque_nm) const LITHE_RT {
  JointArray a{};
  for (std::size_t j = 0; j < joints_; ++j)
    for (std::size_t k = 0; k < joints_; ++k)
      a[j] += observer_.inverse_mass()[j][k] * (torque_nm[k] - observer_.bias_nm()[k]);
  return a;
}

double Coordinated::way_left_rad(std::size_t j, bool up) const LITHE_RT {
  const double q = observer_.then().position_rad[j];
  return up ? joint_[j].max_rad - q : q - joint_[j].min_rad;
}

// Below this speed a joint that is not stopped in time may wait for the others.
double Coordinated::slow_rad_s(std::size_t j, bool up) const LITHE_RT {
  return std::clamp(8 * way_left_rad(j, up), kKeptFreeRad, kSlowRadS);
}

// Enough for its limits, and at least this share of the allotted deceleration.
double Coordinated::brake_rad_s2(std::size_t j, double q, double v, double share, double hardest) const LITHE_RT {
  const Joint& joint = joint_[j];
  const double most = hardest * joint.allotted_rad_s2;
  const double over = std::max(q - joint.max_rad, joint.min_rad - q) + 0.5 * kKeptFreeRad;
  if (over > 0) {
    constexpr double kTimeS = 8e-3, kPerS = 20;
    const double inwards = q > 0.5 * (joint.max_rad + joint.min_rad) ? -1 : 1;
    return std::clamp((inwards * std::min(kBackRadS, kPerS * over) - v) / kTimeS, -most, most);
  }
  constexpr double kLeastWayRad = 1e-3, kTimeS = 4e-3;
  const double left = (v > 0 ? joint.max_rad - q : q - joint.min_rad) - kKeptFreeRad;
  const double needed = v * v / (2 * std::max(left, kLeastWayRad));
  const double a = std::min(std::clamp(needed, share * joint.allotted_rad_s2, most), std::abs(v) / kTimeS);
  return v > 0 ? -a : a;
}

bool Coordinated::stops(std::size_t j, bool up, double rad_s2, double transition_s, double unsure_rad_s2) const
    LITHE_RT {
  const Joint& joint = joint_[j];
  const double side = up ? 1 : -1, least = now_rad_s2_[j] / (1 + error_), unsure_rad_s = unsure_rad_s_[j];
  const double a = side * rad_s2 + unsure_rad_s2;
  Way way{0.5 * unsure_rad_s * observer_.ahead_s(), side * observer_.then().velocity_rad_s[j] + unsure_rad_s};
  way.go(a, a, observer_.hold_s());
  way.go(a, std::min(a, -least), transition_s);
  way.stop(least);
  return way.farthest <= std::max(way_left_rad(j, up) - kKeptFreeRad, 0.0) && way.fastest <= joint.speed_rad_s;
}

bool Coordinated::stops(std::size_t j, bool up, double rad_s2, double transition_s) const LITHE_RT {
  return stops(j, up, rad_s2, transition_s, error_ * std::abs(rad_s2));
}

// From these torques to the brake, all joints together, and the brake's accelerations.
double Coordinated::transition_s(const JointArray& torque_nm, const JointArray& rad_s2, JointArray& brake) const
    LITHE_RT {
  const double hold_s = observer_.hold_s();
  const JointStates& at = observer_.then();
  for (std::size_t j = 0; j < joints_; ++j)
    brake[j] = brake_rad_s2(j, at.position_rad[j] + (at.velocity_rad_s[j] + 0.5 * rad_s2[j] * hold_s) * hold_s,
                            at.velocity_rad_s[j] + rad_s2[j] * hold_s, 1, kHardest);
  double time_s = 0;
  for (std::size_t j = 0; j < joints_; ++j) {
    double nm = observer_.bias_nm()[j];
    for (std::size_t k = 0; k < joints_; ++k) nm += observer_.mass_kg_m2()[j][k] * brake[k];
    time_s = std::max(time_s, std::abs(nm - torque_nm[j]) / joint_[j].slew_nm_s);
  }
  return time_s;
}

// A joint that not even the brake stops need not do better than it.
bool Coordinated::may_wait(std::size_t j, bool up, double torque_nm, double rad_s2) const LITHE_RT {
  constexpr double kSlack = 1e-6;
  const double side = up ? 1 : -1;
  if (!beyond_brake_[j][up] || side * rad_s2 > side * brake_.rad_s2[j] + kSlack) return false;
  return side * observer_.then().velocity_rad_s[j] < slow_rad_s(j, up) ||
         (torque_nm - brake_.torque_nm[j]) * (brake_.wanted_nm[j] - observer_.felt_nm(j)) >= -kTiny;
}

bool Coordinated::all_stop(const JointArray& torque_nm) LITHE_RT {
  const JointStates& at = observer_.then();
  const JointArray a = acceleration(torque_nm);
  JointArray into{}, q{}, v{}, brake{};
  const double time_s = transition_s(torque_nm, a, into), hold_s = observer_.hold_s();
  for (std::size_t j = 0; j < joints_; ++j) {
    for (const bool up : {false, true})
      if (!choice_.ignored[j] && !may_wait(j, up, torque_nm[j], a[j]) && !stops(j, up, a[j], time_s)) return false;
    q[j] = at.position_rad[j] + (at.velocity_rad_s[j] + 0.5 * a[j] * hold_s) * hold_s;
    v[j] = at.velocity_rad_s[j] + a[j] * hold_s;
    q[j] += (v[j] + (a[j] / 3 + into[j] / 6) * time_s) * time_s;
    v[j] += 0.5 * (a[j] + into[j]) * time_s;
    brake[j] = brake_rad_s2(j, q[j], v[j], kGentle, kHardest);
  }
  return torques_reach(q, v, brake);
}

// The torques of the brake, at points of its way, leave what the model may be wrong by.
bool Coordinated::torques_reach(const JointArray& position_rad, const JointArray& velocity_rad_s,
                                const JointArray& brake_rad_s2) LITHE_RT {
  JointArray ends_s{};
  double stop_s = 0;
  for (std::size_t j = 0; j < joints_; ++j) {
    ends_s[j] = std::abs(brake_rad_s2[j]) > kTiny ? std::abs(velocity_rad_s[j] / brake_rad_s2[j]) : 0;
    stop_s = std::max(stop_s, ends_s[j]);
  }
  for (int point = 0; point < kPoints; ++point) {
    const double t = stop_s * point / kPoints;
    JointArray q{}, v{}, a{}, nm{};
    for (std::size_t j = 0; j < joints_; ++j) {
      const double s = std::min(t, ends_s[j]);
      q[j] = position_rad[j] + (velocity_rad_s[j] + 0.5 * brake_rad_s2[j] * s) * s;
      if (t >= ends_s[j]) continue;
      v[j] = velocity_rad_s[j] + brake_rad_s2[j] * s;
      a[j] = brake_rad_s2[j];
    }
    observer_.tree().pose(q);
    observer_.tree().torque(v, a, nm);
    for (std::size_t j = 0; j < joints_; ++j)
      if (!choice_.ignored[j] && std::abs(nm[j]) * (1 + error_) > robot::kUsableTorque * joint_[j].torque_nm)
        return false;
  }
  return true;
}

// The torque of a brake, and its first step: as far as slew permits, all joints on one line. Of `extra` as much as all
// torques permit.
void Coordinated::plan(const JointArray& rad_s2, const JointArray& extra_rad_s2) LITHE_RT {
  JointArray more{};
  double part = 1, share = 1;
  for (std::size_t j = 0; j < joints_; ++j) {
    double nm = observer_.bias_nm()[j];
    for (std::size_t k = 0; k < joints_; ++k) {
      nm += observer_.mass_kg_m2()[j][k] * rad_s2[k];
      more[j] += observer_.mass_kg_m2()[j][k] * extra_rad_s2[k];
    }
    const double most = joint_[j].torque_nm;
    brake_.wanted_nm[j] = std::clamp(nm, -most, most);
    const double room = more[j] > 0 ? most - brake_.wanted_nm[j] : brake_.wanted_nm[j] + most;
    if (std::abs(more[j]) > room) part = std::min(part, room / std::abs(more[j]));
  }
  for (std::size_t j = 0; j < joints_; ++j) {
    brake_.wanted_nm[j] += part * more[j];
    const double felt = observer_.felt_nm(j), way = brake_.wanted_nm[j] - felt;
    if (choice_.least_nm[j] == choice_.most_nm[j]) continue;
    const double room = std::max(way > 0 ? choice_.most_nm[j] - felt : felt - choice_.least_nm[j], 0.0);
    if (std::abs(way) > room) share = std::min(share, room / std::abs(way));
  }
  for (std::size_t j = 0; j < joints_; ++j) {
    const double felt = observer_.felt_nm(j);
    brake_.torque_nm[j] =
        std::clamp(felt + share * (brake_.wanted_nm[j] - felt), choice_.least_nm[j], choice_.most_nm[j]);
  }
  brake_.rad_s2 = acceleration(brake_.torque_nm);
}

// Joints that the brake would not stop: `extra` for them, with what the model may be wrong by.
bool Coordinated::harden(const JointArray& rad_s2, JointArray& extra_rad_s2, std::array<bool, kMaxJoints>& hard) const
    LITHE_RT {
  JointArray into{};
  const double time_s = transition_s(brake_.torque_nm, brake_.rad_s2, into);
  bool any = false;
  for (std::size_t j = 0; j < joints_; ++j)
    for (const bool up : {false, true}) {
      const double side = up ? 1 : -1;
      if (side * observer_.then().velocity_rad_s[j] <= slow_rad_s(j, up) || stops(j, up, brake_.rad_s2[j], time_s))
        continue;
      double others = 0;
      for (std::size_t k = 0; k < joints_; ++k)
        if (k != j)
          others += std::abs(observer_.inverse_mass()[j][k]) * std::abs(observer_.felt_nm(k) - observer_.bias_nm()[k]);
      extra_rad_s2[j] -= side * (std::abs(rad_s2[j]) + error_ * others);
      hard[j] = any = true;
    }
  return any;
}

void Coordinated::choose_brake() LITHE_RT {
  const JointStates& at = observer_.then();
  JointArray rad_s2{}, extra{};
  for (std::size_t j = 0; j < joints_; ++j) {
    rad_s2[j] = brake_rad_s2(j, at.position_rad[j], at.velocity_rad_s[j], 1, kHarder);
    extra[j] = brake_rad_s2(j, at.position_rad[j], at.velocity_rad_s[j], 1, kHardest) - rad_s2[j];
  }
  plan(rad_s2, extra);
  std::array<bool, kMaxJoints> hard{};
  if (!harden(rad_s2, extra, hard)) return;
  plan(rad_s2, extra);
  for (std::size_t j = 0; j < joints_; ++j)
    if (hard[j]) brake_.torque_nm[j] = std::clamp(brake_.wanted_nm[j], choice_.least_nm[j], choice_.most_nm[j]);
  brake_.rad_s2 = acceleration(brake_.torque_nm);
}

// The largest acceleration to this side between the brake's and this one after which the joint stops.
double Coordinated::restricted(std::size_t j, bool up, double rad_s2, double transition_s) const LITHE_RT {
  double good = brake_.rad_s2[j], bad = rad_s2;
  if (beyond_brake_[j][up]) return good;
  for (int i = 0; i < kHalvings + 1; ++i) {
    const double middle = 0.5 * (good + bad);
    (stops(j, up, middle, transition_s) ? good : bad) = middle;
  }
  return good;
}

// Each joint alone. True if that changed a torque.
bool Coordinated::restrict_each(JointArray& torque_nm) LITHE_RT {
  JointArray a = acceleration(torque_nm), into{};
  const double time_s = transition_s(torque_nm, a, into), brake_s = transition_s(brake_.torque_nm, brake_.rad_s2, into);
  bool changed = false;
  for (std::size_t j = 0; j < joints_; ++j)
    for (const bool up : {false, true}) {
      beyond_brake_[j][up] = !stops(j, up, brake_.rad_s2[j], brake_s);
      const double side = up ? 1 : -1;
      if (side * a[j] <= side * brake_.rad_s2[j] || stops(j, up, a[j], time_s)) continue;
      a[j] = restricted(j, up, a[j], time_s);
      changed = true;
    }
  if (!changed) return false;
  for (std::size_t j = 0; j < joints_; ++j) {
    double nm = observer_.bias_nm()[j];
    for (std::size_t k = 0; k < joints_; ++k) nm += observer_.mass_kg_m2()[j][k] * a[k];
    torque_nm[j] = std::clamp(nm, choice_.least_nm[j], choice_.most_nm[j]);
  }
  return true;
}

// The allotted deceleration is for the worst pose and the worst directions. Here all torques reach for more.
void Coordinated::allot_now() LITHE_RT {
  const JointArray& speed_rad_s = observer_.then().velocity_rad_s;
  double scale = kNowMost / kNowShare;
  for (std::size_t j = 0; j < joints_; ++j) {
    double sure_nm = 0, unsure_nm = 0;  // unsure: of joints that may turn round
    for (std::size_t k = 0; k < joints_; ++k) {
      const double nm = observer_.mass_kg_m2()[j][k] * joint_[k].allotted_rad_s2;
      if (std::abs(speed_rad_s[k]) < kSlowRadS)
        unsure_nm += std::abs(nm);
      else
        sure_nm -= std::copysign(nm, nm * speed_rad_s[k]);
    }
    const double usable_nm = robot::kUsableTorque * joint_[j].torque_nm / (1 + error_),
                 bias_nm = observer_.bias_nm()[j];
    if (sure_nm + unsure_nm > 0) scale = std::min(scale, (usable_nm - bias_nm) / (sure_nm + unsure_nm));
    if (sure_nm - unsure_nm < 0) scale = std::min(scale, (usable_nm + bias_nm) / (unsure_nm - sure_nm));
  }
  for (std::size_t j = 0; j < joints_; ++j)
    now_rad_s2_[j] = joint_[j].allotted_rad_s2 * std::max(kNowShare * scale, 1.0);
}

// A drive that is not asked next keeps what it has.
void Coordinated::prepare(const Choice& choice) LITHE_RT {
  choice_ = choice;
  beyond_brake_ = {};
  allot_now();
  for (std::size_t j = 0; j < joints_; ++j) {
    if (!observer_.asked(j)) choice_.least_nm[j] = choice_.most_nm[j] = observer_.felt_nm(j);
    double rad_s2 = 0;
    for (std::size_t k = 0; k < joints_; ++k)
      rad_s2 += observer_.inverse_mass()[j][k] * (observer_.then().torque_nm[k] - observer_.bias_nm()[k]);
    unsure_rad_s_[j] = kUnsureRadS + error_ * std::abs(rad_s2) * observer_.ahead_s();
  }
}

void Coordinated::bound(const Choice& choice, JointArray& torque_nm) LITHE_RT {
  prepare(choice);
  for (std::size_t j = 0; j < joints_; ++j)
    torque_nm[j] = std::clamp(torque_nm[j], choice_.least_nm[j], choice_.most_nm[j]);
  if (all_stop(torque_nm)) return;
  choose_brake();
  if (restrict_each(torque_nm) && all_stop(torque_nm)) return;
  const JointArray far = torque_nm;
  double good = 0, bad = 1;
  const auto set = [&](double share) {
    for (std::size_t j = 0; j < joints_; ++j)
      torque_nm[j] = brake_.torque_nm[j] + share * (far[j] - brake_.torque_nm[j]);
  };
  for (int i = 0; i < kHalvings; ++i) {
    const double middle = 0.5 * (good + bad);
    set(middle);
    (all_stop(torque_nm) ? good : bad) = middle;
  }
  set(good);
}

}  // namespace lithe::guard
