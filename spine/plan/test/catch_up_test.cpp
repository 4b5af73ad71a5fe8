// SPDX-License-Identifier: Apache-2.0
// A setpoint that is far from its plan moves to it within the joint's limits, and then follows the plan exactly.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>

#include "spine/plan/test/plan_rig.hpp"

namespace lithe::plan {
namespace {

using wire::PlanReject;
using wire::PlanState;

constexpr double kLimitRadS = 12, kLimitRadS2 = 20;  // robot_with()'s deceleration

robot::RobotConfig robot_of_joint() {
  robot::RobotConfig robot = robot_with(1);
  robot.joints[0].velocity_max_rad_s = kLimitRadS;
  return robot;
}

// A motion that a Brain streams: two sines, at most 2.6 rad, 5 rad/s and 9.6 rad/s2.
struct Motion {
  double phase = 0;
  double at(double t_ms) const { return 1.9 * std::sin(1.9 * t_ms * 1e-3 + phase) + 0.7 * std::sin(0.6 * t_ms * 1e-3); }
  // Waypoints of it from `from_ms` on.
  wire::Plan plan(double from_ms, double gap_ms, int count) const {
    std::vector<Waypoint> waypoints;
    for (int w = 0; w < count; ++w) waypoints.push_back({from_ms + w * gap_ms, at(from_ms + w * gap_ms)});
    return make_plan(waypoints, true);
  }
};

double between(std::mt19937_64& random, double low, double high) {
  return std::uniform_real_distribution<double>(low, high)(random);
}

struct Tally {
  int caught_up = 0;       // how often the setpoint was far away and reached the motion
  double fastest = 0;      // [rad/s]
  double hardest = 0;      // [rad/s2], by second differences
  double hardest_far = 0;  // the same, while the remaining distance is too large for a blend
  double late_error = 0;   // [rad], at a time when it must have caught up
};

// One setpoint at 1 kHz, and the figures recorded about it.
class Follower {
 public:
  Follower(Tally& tally, double position_rad) : bench_(robot_of_joint(), position_rad), tally_(tally) {}

  void run(const Motion& motion, double for_ms, double plan_every_ms, double starts_ms, double gap_ms) {
    for (const double until_ms = t_ms_ + for_ms; t_ms_ < until_ms; ++t_ms_) {
      if (plan_every_ms > 0 && std::fmod(t_ms_, plan_every_ms) < 1)
        EXPECT_EQ(bench_.accept(motion.plan(t_ms_ + starts_ms, gap_ms, 12), t_ms_), PlanReject::none) << t_ms_;
      look(std::abs(motion.at(t_ms_) - last_rad_) > 0.9);
    }
  }
  double error_rad(const Motion& motion) {
    return std::abs(bench_.at(t_ms_ - 1).position_rad[0] - motion.at(t_ms_ - 1));
  }

 private:
  void look(bool far) {
    const Setpoint now = bench_.at(t_ms_);
    const double rad = now.position_rad[0];
    tally_.fastest = std::max(tally_.fastest, std::abs(now.velocity_rad_s[0]));
    if (seen_++ >= 2) {
      const double acceleration = std::abs(rad - 2 * last_rad_ + before_rad_) * 1e6;
      tally_.hardest = std::max(tally_.hardest, acceleration);
      if (far && was_far_) tally_.hardest_far = std::max(tally_.hardest_far, acceleration);
    }
    if (was_far_ && !far) ++tally_.caught_up;
    was_far_ = far;
    before_rad_ = last_rad_;
    last_rad_ = rad;
  }

  Bench bench_;
  Tally& tally_;
  double t_ms_ = 0;
  int seen_ = 0;
  bool was_far_ = false;
  double last_rad_ = 0, before_rad_ = 0;
};

// Random motions, start positions, plan rates and pauses of the stream; the robot is armed while it runs.
Tally random_streams() {
  std::mt19937_64 random(17);
  Tally tally;
  for (int round = 0; round < 60; ++round) {
    const Motion motion{between(random, 0, 6)};
    Follower follower(tally, between(random, -2.9, 2.9));
    const double every_ms = std::floor(between(random, 5, 60));
    const double starts_ms = between(random, -40, 120);
    const double gap_ms = between(random, 15, 50);
    for (int stall = 0; stall < 3; ++stall) {
      follower.run(motion, 3500, every_ms, starts_ms, gap_ms);
      tally.late_error = std::max(tally.late_error, follower.error_rad(motion));
      follower.run(motion, between(random, 300, 4000), 0, 0, 0);  // the publisher stalls
    }
  }
  return tally;
}

TEST(CatchUp, WhateverTheStreamDidTheSetpointStaysWithinItsLimitsAndComesBackToThePlan) {
  const Tally tally = random_streams();
  EXPECT_GT(tally.caught_up, 60);
  EXPECT_LE(tally.fastest, kLimitRadS * (1 + 1e-9));
  // The motion's own 9.6, a little more of its interpolation, and a blend of at most twice the limit.
  EXPECT_LT(tally.hardest, 2 * kLimitRadS2 + 15);
  EXPECT_LT(tally.hardest_far, 1.3 * kLimitRadS2);
  EXPECT_LT(tally.late_error, 2e-3);
}

// The limits above must refuse this: a blend of half a second for any distance.
TEST(CatchUp, ABlendOfHalfASecondAloneWouldBreakTheseLimits) {
  const Decay decay = Decay::over(4.0, 5.0, 0.5);
  double hardest = 0;
  for (double t_s = 0; t_s < 0.5; t_s += 0.001)
    hardest = std::max(hardest, std::abs(decay.acceleration(decay.left(t_s))));
  EXPECT_GT(hardest, 1.5 * (2 * kLimitRadS2 + 15)) << hardest;
}

TEST(CatchUp, AfterwardsTheSetpointIsThePlansToTheLastBit) {
  const Motion motion{1.0};
  const wire::Plan plan = motion.plan(0, 300, 16);
  Bench near(robot_of_joint(), motion.at(0)), far(robot_of_joint(), -2.0);
  ASSERT_EQ(near.accept(plan, 0), PlanReject::none);
  ASSERT_EQ(far.accept(plan, 0), PlanReject::none);
  double apart = 0;
  for (double t = 0; t < 4400; ++t) {
    const Setpoint a = near.at(t), b = far.at(t);
    apart = std::max(apart, std::abs(a.position_rad[0] - b.position_rad[0]));
    if (t < 3000) continue;
    ASSERT_EQ(a.position_rad[0], b.position_rad[0]) << t;
    ASSERT_EQ(a.velocity_rad_s[0], b.velocity_rad_s[0]) << t;
    ASSERT_EQ(a.acceleration_rad_s2[0], b.acceleration_rad_s2[0]) << t;
  }
  EXPECT_GT(apart, 2.0);
}

TEST(CatchUp, APlanThatEndsMeanwhileIsStillReached) {
  Bench bench(robot_of_joint(), -2.8);
  const wire::Plan plan = make_plan({{-20, 2.5, 0}, {20, 2.5, 0}, {40, 2.5, 0}, {60, 2.5, 0}}, true);
  ASSERT_EQ(bench.accept(plan, 0), PlanReject::none);
  EXPECT_EQ(bench.at(300).state, PlanState::coast) << "not at rest yet";
  for (double t = 300; t < 4000; ++t) (void)bench.at(t);
  EXPECT_EQ(bench.at(4000).position_rad[0], 2.5);
  EXPECT_EQ(bench.at(4000).state, PlanState::hold);
}

TEST(CatchUp, AStopMeanwhileBringsItToRestFromWhereItIs) {
  Bench bench(robot_of_joint(), -2.8);
  const Motion motion{1.5};
  ASSERT_EQ(bench.accept(motion.plan(0, 300, 16), 0), PlanReject::none);
  for (double t = 0; t < 300; ++t) (void)bench.at(t);
  const Setpoint before = bench.at(300);
  EXPECT_GT(before.velocity_rad_s[0], 2.0);
  bench.interpolator.stop(kStart + 300 * kMs);
  const Setpoint after = bench.at(300);
  EXPECT_EQ(after.position_rad[0], before.position_rad[0]);
  EXPECT_EQ(after.velocity_rad_s[0], before.velocity_rad_s[0]);
  EXPECT_EQ(bench.at(3000).velocity_rad_s[0], 0.0);
  EXPECT_EQ(bench.at(3000).state, PlanState::hold);
}

TEST(CatchUp, AStreamThatStartsAheadIsNotReachedByAJerk) {
  for (const double starts_ms : {55.0, 90.0}) {
    Tally tally;
    const Motion motion{1.2};
    Follower follower(tally, -1.0);  // over two radians away
    follower.run(motion, 3000, 20, starts_ms, 20);
    EXPECT_LT(tally.hardest, 2 * kLimitRadS2 + 15);
    EXPECT_LT(follower.error_rad(motion), 2e-3);
  }
}

}  // namespace
}  // namespace lithe::plan
