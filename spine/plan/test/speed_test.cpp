// SPDX-License-Identifier: Apache-2.0
// With any sequence of accepted plans, the setpoint is never faster than the joint's limit. Slow plans are accepted.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>

#include "spine/plan/test/plan_rig.hpp"

namespace lithe::plan {
namespace {

using wire::PlanReject;

constexpr double kLimitRadS = 30;
constexpr std::size_t kJoints = 3;  // the last one monotone

robot::RobotConfig robot_of(double range_rad) {
  robot::RobotConfig robot = robot_with(kJoints);
  robot.joints[kJoints - 1].monotone = true;
  for (robot::JointConfig& joint : robot.joints) {
    joint.position_min_rad = -range_rad;
    joint.position_max_rad = range_rad;
  }
  return robot;
}

double between(std::mt19937_64& random, double low, double high) {
  return std::uniform_real_distribution<double>(low, high)(random);
}

// Random waypoints, gaps of 2 to 400 ms, some with given velocities. No joint's mean speed from the setpoint to the
// first waypoint ahead, or between two of them, is above `most_rad_s`, and no given velocity is.
wire::Plan random_plan(std::mt19937_64& random, double now_ms, const JointArray& from_rad, double range_rad,
                       double most_rad_s) {
  wire::Plan plan = make_plan({}, random() % 2 == 0, kJoints);
  plan.waypoint_count = static_cast<std::uint32_t>(1 + random() % wire::kNw);
  double t_ms = now_ms + between(random, -60, 250);
  const bool gives_velocities = random() % 4 == 0;
  for (std::size_t w = 0; w < plan.waypoint_count; ++w) {
    const double gap_ms = 2 * std::exp(between(random, 0, std::log(200.0)));
    if (w > 0) t_ms += gap_ms;
    plan.t_ns[w] = kStart + std::llround(t_ms * 1e6);
    for (std::size_t j = 0; j < kJoints; ++j) {
      const double lasts_ms = std::max(0.0, w > 0 ? std::min(gap_ms, t_ms - now_ms) : t_ms - now_ms);
      const double way_rad = most_rad_s * lasts_ms * 1e-3 * between(random, -1, 1);
      const double before_rad = w > 0 ? plan.position_rad[(w - 1) * wire::kNj + j] : from_rad[j];
      plan.position_rad[w * wire::kNj + j] = std::clamp(before_rad + way_rad, -range_rad, range_rad);
      plan.velocity_rad_s[w * wire::kNj + j] =
          gives_velocities && random() % 3 == 0 ? most_rad_s * between(random, -1, 1) : kNan;
    }
  }
  return plan;
}

struct Tally {
  int accepted = 0, refused = 0;
  double fastest = 0;        // reported velocity over the limit
  double fastest_move = 0;   // the same, computed from two samples of the position
  double position_jump = 0;  // at a splice
  double velocity_jump = 0;  // at a splice
};

class Follower {
 public:
  Follower(double range_rad, Tally& tally) : bench_(robot_of(range_rad)), tally_(tally) {}

  // Offers a plan and compares the setpoint before and after, at the same time.
  void offer(std::mt19937_64& random, double range_rad, double most_rad_s) {
    const Setpoint before = bench_.at(t_ms_);
    const wire::Plan plan = random_plan(random, t_ms_, before.position_rad, range_rad, most_rad_s);
    const PlanReject reject = bench_.accept(plan, t_ms_);
    EXPECT_TRUE(reject == PlanReject::none || reject == PlanReject::velocity_limit || reject == PlanReject::too_old);
    tally_.accepted += reject == PlanReject::none ? 1 : 0;
    tally_.refused += reject == PlanReject::velocity_limit ? 1 : 0;
    const Setpoint after = bench_.at(t_ms_);
    for (std::size_t j = 0; j < kJoints; ++j) {
      tally_.position_jump = std::max(tally_.position_jump, std::abs(after.position_rad[j] - before.position_rad[j]));
      tally_.velocity_jump =
          std::max(tally_.velocity_jump, std::abs(after.velocity_rad_s[j] - before.velocity_rad_s[j]));
    }
  }

  void follow(std::mt19937_64& random, double for_ms) {
    const double until_ms = t_ms_ + for_ms;
    Setpoint last = bench_.at(t_ms_);
    while (t_ms_ < until_ms) {
      const double step_ms = std::ceil(between(random, 0, 2) * 1e6) * 1e-6;
      t_ms_ += step_ms;
      const Setpoint now = bench_.at(t_ms_);
      for (std::size_t j = 0; j < kJoints; ++j) {
        const double moved_rad = std::max(0.0, std::abs(now.position_rad[j] - last.position_rad[j]) - 1e-9);
        tally_.fastest_move = std::max(tally_.fastest_move, moved_rad / (step_ms * 1e-3 * kLimitRadS));
        tally_.fastest = std::max(tally_.fastest, std::abs(now.velocity_rad_s[j]) / kLimitRadS);
      }
      last = now;
    }
  }

 private:
  Bench bench_;
  Tally& tally_;
  double t_ms_ = 0;
};

// 200 motions of 50 plans each; every plan starts in the state that the one before has left.
Tally follow_random_plans(double range_rad, double most_rad_s) {
  std::mt19937_64 random(11);
  Tally tally;
  for (int motion = 0; motion < 200; ++motion) {
    Follower follower(range_rad, tally);
    for (int i = 0; i < 50; ++i) {
      follower.offer(random, range_rad, most_rad_s);
      follower.follow(random, random() % 8 == 0 ? 900 : between(random, 0, 120));  // ended, or still running
    }
  }
  return tally;
}

TEST(Speed, ItNeverExceedsTheLimitAndNeverJumpsWhateverIsAccepted) {
  for (const double most_rad_s : {0.3 * kLimitRadS, 0.7 * kLimitRadS, kLimitRadS}) {
    const Tally tally = follow_random_plans(20, most_rad_s);
    EXPECT_LE(tally.fastest, 1 + 1e-9);
    EXPECT_LE(tally.fastest_move, 1 + 1e-9);
    EXPECT_LE(tally.position_jump, 1e-12);
    EXPECT_LE(tally.velocity_jump, 1e-9);
    EXPECT_GT(tally.accepted, 500) << most_rad_s;
  }
}

TEST(Speed, PositionLimitsNeverMakeItFaster) {
  const Tally tally = follow_random_plans(0.4, 0.7 * kLimitRadS);
  EXPECT_LE(tally.fastest, 1 + 1e-9);
  EXPECT_LE(tally.fastest_move, 1 + 1e-9);
  EXPECT_LE(tally.position_jump, 1e-12);
  EXPECT_GT(tally.accepted, 500);
}

TEST(Speed, PlansWithTimeToSpareAreNeverRefused) {
  const Tally slow = follow_random_plans(20, 0.2 * kLimitRadS);
  EXPECT_EQ(slow.refused, 0);
  EXPECT_GT(slow.accepted, 8000);
  const Tally brisk = follow_random_plans(20, 0.4 * kLimitRadS);
  EXPECT_LT(brisk.refused, brisk.accepted / 20);
}

TEST(Speed, AGoToNeedsHalfAsMuchTimeAgainAsItsMeanSpeedSays) {
  Bench bench;
  EXPECT_EQ(bench.accept(make_plan({{100, 2.01}}), 0), PlanReject::velocity_limit);  // 30.15 rad/s halfway
  EXPECT_EQ(bench.accept(make_plan({{100, 1.99}}), 0), PlanReject::none);
}

TEST(Speed, ASpliceThatMustCatchUpNeverExceedsTheLimitAndArrivesWhenThePlanSlowsDown) {
  Bench bench(robot_of(30));
  // The setpoint moves at 28 rad/s already; from rest it would have to be faster to arrive in time.
  const wire::Plan running = make_plan({{-20, -0.56, 28}, {580, 16.24, 28}}, true, kJoints);
  ASSERT_EQ(bench.accept(running, 0), PlanReject::none);
  double fastest = 0;
  for (double t = 0; t < 6000; ++t) fastest = std::max(fastest, std::abs(bench.at(t).velocity_rad_s[0]));
  EXPECT_LE(fastest, kLimitRadS);
  EXPECT_GT(fastest, 15);
  EXPECT_EQ(bench.at(6000).state, wire::PlanState::hold);
  EXPECT_NEAR(bench.at(6000).position_rad[0], 30, 1e-9) << "the plan coasts to the joint's limit";
}

TEST(Speed, AVelocityNobodyGaveIsChosenWithinTheLimit) {
  Bench bench;
  // The parabola through the last three leaves at 36 rad/s; the curve leaves at the limit.
  ASSERT_EQ(bench.accept(make_plan({{200, 0.0}, {230, 0.42}, {260, 1.17}}, true), 0), PlanReject::none);
  EXPECT_NEAR(bench.at(259.999999).velocity_rad_s[0], kLimitRadS, 1e-3);
}

}  // namespace
}  // namespace lithe::plan
