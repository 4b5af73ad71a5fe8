// SPDX-License-Identifier: Apache-2.0
// How far a joint still moves, and how fast it becomes, when it is braked as hard as its limits allow.
#pragma once

#include <algorithm>
#include <cmath>

#include "spine/core/rt.hpp"
#include "spine/robot/config.hpp"

namespace lithe::robot {

// What braking is reckoned with. All positive; torque_max_nm above load_nm.
struct Brakes {
  double load_nm = 0;            // the worst that pushes the joint, in either direction
  double torque_max_nm = 0;      // of the drive, at the joint
  double slew_nm_s = 0;          // the fastest the torque changes
  double inertia_min_kg_m2 = 0;  // what speeds up
  double inertia_max_kg_m2 = 0;  // what must be braked

  double deceleration_rad_s2() const LITHE_RT { return (torque_max_nm - load_nm) / inertia_max_kg_m2; }
};

// One torque for so long.
struct Stretch {
  double torque_nm = 0;
  double time_s = 0;
};

struct Stop {
  double way_rad = 0;     // the farthest outwards from here; not negative
  double peak_rad_s = 0;  // the fastest outwards
};

// Adds up pieces of motion with a constant jerk: position, speed and the extremes of both.
class Excursion {
 public:
  explicit Excursion(double velocity_rad_s) LITHE_RT : v_(velocity_rad_s), peak_(velocity_rad_s) {}

  // `jerk` is taken away from the acceleration each second; not negative.
  void move(double acceleration, double jerk, double time_s) LITHE_RT {
    if (!(time_s > 0)) return;
    const double turns_s = turning_s(acceleration, jerk);
    if (turns_s < time_s) way_ = std::max(way_, at(acceleration, jerk, turns_s));
    x_ = at(acceleration, jerk, time_s);
    v_ += (acceleration - 0.5 * jerk * time_s) * time_s;
    way_ = std::max(way_, x_);
    peak_ = std::max(peak_, v_);
  }
  Stop brake(double deceleration) LITHE_RT {
    if (v_ > 0) way_ = std::max(way_, x_ + 0.5 * v_ * v_ / deceleration);
    return {way_, peak_};
  }

 private:
  double at(double acceleration, double jerk, double t) const LITHE_RT {
    return x_ + (v_ + (0.5 * acceleration - jerk * t / 6) * t) * t;
  }
  // When the motion turns from outwards to inwards: the larger root of v + a t - j t^2 / 2 = 0.
  double turning_s(double a, double j) const LITHE_RT {
    constexpr double kNever = 1e300;
    if (j <= 0) return a < 0 && v_ > 0 ? -v_ / a : kNever;
    const double inside = a * a + 2 * j * v_;
    if (inside < 0) return kNever;
    const double t = (a + std::sqrt(inside)) / j;
    return t > 0 ? t : kNever;
  }

  double x_ = 0, v_, way_ = 0, peak_;
};

// Outwards is positive. The joint moves with `velocity_rad_s`; `first` and then `next` act on it, and after them the
// torque falls by the slew to full braking. At every moment the worst load pushes outwards, and the inertia is the one
// that makes it worse. Constant torque: x = v t + a t^2 / 2; falling torque: a constant jerk -slew / inertia; full
// braking: v^2 / 2a.
// Contract: RT · no loop
inline Stop stop_of(const Brakes& brakes, double velocity_rad_s, Stretch first, Stretch next) LITHE_RT {
  const auto acceleration = [&brakes](double torque_nm) LITHE_RT {
    const double net_nm = torque_nm + brakes.load_nm;
    return net_nm / (net_nm > 0 ? brakes.inertia_min_kg_m2 : brakes.inertia_max_kg_m2);
  };
  Excursion way(velocity_rad_s);
  way.move(acceleration(first.torque_nm), 0, first.time_s);
  way.move(acceleration(next.torque_nm), 0, next.time_s);
  const double outward_nm = std::max(next.torque_nm + brakes.load_nm, 0.0);
  way.move(outward_nm / brakes.inertia_min_kg_m2, brakes.slew_nm_s / brakes.inertia_min_kg_m2,
           outward_nm / brakes.slew_nm_s);
  const double from_nm = std::min(next.torque_nm, -brakes.load_nm);
  way.move((from_nm + brakes.load_nm) / brakes.inertia_max_kg_m2, brakes.slew_nm_s / brakes.inertia_max_kg_m2,
           (from_nm + brakes.torque_max_nm) / brakes.slew_nm_s);
  return way.brake(brakes.deceleration_rad_s2());
}

inline Brakes brakes_of(const JointConfig& joint) {
  return {joint.load_max_nm, joint.torque_max_nm, joint.torque_slew_nm_s, joint.inertia_min_kg_m2,
          joint.inertia_max_kg_m2};
}

// Ticks between which a drive is asked, and after which a command that left has reached it.
inline double drive_period_s(const RobotConfig& robot, const JointConfig& joint) {
  const bool known = joint.device < robot.devices.size();
  return (known ? robot.devices[joint.device].rate_divider : 1) / robot.rate_hz;
}

// From a sample that has just come to the torque of the command that follows from it: one tick of the pipeline; for a
// drive that is asked in every Nth tick, a sample that may be N - 1 ticks old and a command that waits as long; for
// CiA 402 the SYNC after the command; the drive's own lag.
inline double reaction_s(const RobotConfig& robot, const JointConfig& joint) {
  const bool waits_for_sync = joint.device < robot.devices.size() && facts(robot.devices[joint.device].kind).is_synced;
  const double period_s = drive_period_s(robot, joint);
  return (waits_for_sync ? 2 : 1) / robot.rate_hz + 2 * (period_s - 1 / robot.rate_hz) + joint.drive_lag_s;
}

// The way a joint needs to stop from this speed under full torque outwards.
inline double stopping_way_rad(const RobotConfig& robot, const JointConfig& joint, double velocity_rad_s) {
  const double reaction = reaction_s(robot, joint) + 1 / robot.rate_hz;  // the sample may be one exchange old
  return stop_of(brakes_of(joint), velocity_rad_s, {joint.torque_max_nm, reaction},
                 {joint.torque_max_nm, drive_period_s(robot, joint)})
      .way_rad;
}

// How far a PD on a bare inertia is from instability, as a phase [rad]; negative: it swings up. The torque
// -kp x - kd v comes `delay_s` after the state it is computed from, half a sample of the hold included:
//   inertia s^2 + (kd s + kp) e^(-delay s) = 0
// crosses over at inertia^2 w^4 = kp^2 + kd^2 w^2, with the phase margin atan(kd w / kp) - w delay. Friction, which
// would help, is left out. Source: the phase margin with the hold as a delay, Astrom and Wittenmark, Computer-
// Controlled Systems, 3rd ed., chapters 3.4 and 5.
inline double phase_margin_rad(double inertia_kg_m2, double kp_nm_rad, double kd_nm_s_rad, double delay_s) {
  const double kd2 = kd_nm_s_rad * kd_nm_s_rad;
  const double inside = kd2 * kd2 + 4 * inertia_kg_m2 * inertia_kg_m2 * kp_nm_rad * kp_nm_rad;
  const double crossover_rad_s = std::sqrt((kd2 + std::sqrt(inside)) / 2) / inertia_kg_m2;
  return std::atan2(kd_nm_s_rad * crossover_rad_s, kp_nm_rad) - crossover_rad_s * delay_s;
}

}  // namespace lithe::robot
