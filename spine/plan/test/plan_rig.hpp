// SPDX-License-Identifier: Apache-2.0
// Common parts of the plan tests: a robot, a way to write plans, and a recorder that samples at 1 kHz.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "spine/plan/interpolator.hpp"

namespace lithe::plan {

inline constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
inline constexpr std::int64_t kStart = 1'000'000'000'000;  // any CLOCK_MONOTONIC time
inline constexpr std::int64_t kMs = 1'000'000;

inline robot::RobotConfig robot_with(std::size_t joints) {
  robot::RobotConfig robot;
  robot.joints.resize(joints);
  for (robot::JointConfig& joint : robot.joints) {
    joint.position_min_rad = -3;
    joint.position_max_rad = 3;
    joint.velocity_max_rad_s = 30;
    joint.deceleration_rad_s2 = 20;
  }
  return robot;
}

struct Waypoint {
  double t_ms;  // after kStart
  double position_rad;
  double velocity_rad_s = kNan;
};

// The same waypoints for every joint.
inline wire::Plan make_plan(const std::vector<Waypoint>& waypoints, bool streaming = false, std::size_t joints = 1) {
  wire::Plan plan;
  plan.plan_id = 1;
  plan.waypoint_count = static_cast<std::uint32_t>(waypoints.size());
  plan.joint_count = static_cast<std::uint32_t>(joints);
  plan.streaming = streaming ? 1 : 0;
  for (std::size_t w = 0; w < waypoints.size() && w < wire::kNw; ++w) {
    plan.t_ns[w] = kStart + std::llround(waypoints[w].t_ms * 1e6);
    for (std::size_t j = 0; j < joints; ++j) {
      plan.position_rad[w * wire::kNj + j] = waypoints[w].position_rad;
      plan.velocity_rad_s[w * wire::kNj + j] = waypoints[w].velocity_rad_s;
    }
  }
  return plan;
}

struct Bench {
  explicit Bench(const robot::RobotConfig& robot = robot_with(1), double position_rad = 0) {
    interpolator.configure(robot);
    JointArray position{};
    position.fill(position_rad);
    interpolator.hold_at(position);
  }
  Setpoint at(double t_ms) { return interpolator.sample(kStart + std::llround(t_ms * 1e6)); }
  wire::PlanReject accept(const wire::Plan& plan, double t_ms) { return reason_of(decide(plan, t_ms)); }
  wire::PlanDecision decide(const wire::Plan& plan, double t_ms) {
    return interpolator.accept(plan, kStart + std::llround(t_ms * 1e6));
  }
  Interpolator interpolator;
};

// Joint 0, sampled every `step_ms`.
struct Trace {
  double step_ms = 1;
  std::vector<double> position, velocity, acceleration;

  void add(const Setpoint& setpoint) {
    position.push_back(setpoint.position_rad[0]);
    velocity.push_back(setpoint.velocity_rad_s[0]);
    acceleration.push_back(setpoint.acceleration_rad_s2[0]);
  }
  // The largest change from sample to sample: an upper limit of any jump.
  static double largest_step(const std::vector<double>& values) {
    double largest = 0;
    for (std::size_t i = 1; i < values.size(); ++i) largest = std::max(largest, std::abs(values[i] - values[i - 1]));
    return largest;
  }
  // Acceleration at the motor: second difference of the commanded position.
  double peak_acceleration() const {
    double peak = 0;
    const double step_s = step_ms * 1e-3;
    for (std::size_t i = 2; i < position.size(); ++i)
      peak = std::max(peak, std::abs(position[i] - 2 * position[i - 1] + position[i - 2]) / (step_s * step_s));
    return peak;
  }
  // Largest difference between the reported velocity and the slope of the reported position.
  double velocity_mismatch() const {
    double worst = 0;
    for (std::size_t i = 1; i + 1 < position.size(); ++i) {
      const double slope = (position[i + 1] - position[i - 1]) / (2 * step_ms * 1e-3);
      worst = std::max(worst, std::abs(slope - velocity[i]));
    }
    return worst;
  }
};

}  // namespace lithe::plan
