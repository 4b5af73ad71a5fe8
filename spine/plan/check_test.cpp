// SPDX-License-Identifier: Apache-2.0
#include "spine/plan/check.hpp"

#include <gtest/gtest.h>

#include <random>

#include "spine/plan/test/plan_rig.hpp"

namespace lithe::plan {
namespace {

using wire::PlanReject;

constexpr double kInf = std::numeric_limits<double>::infinity();

PlanReject verdict(const wire::Plan& plan) {
  Bench bench(robot_with(2));
  return bench.accept(plan, 0);
}

wire::Plan good() { return make_plan({{100, 0.1}, {200, 0.2}, {300, 0.3}}, false, 2); }

TEST(Check, AGoodPlanIsAccepted) { EXPECT_EQ(verdict(good()), PlanReject::none); }

TEST(Check, ACountOfWaypointsOutsideTheCapacityIsRefused) {
  for (const std::uint32_t count : {0U, 17U, 0xFFFFFFFFU}) {
    wire::Plan plan = good();
    plan.waypoint_count = count;
    EXPECT_EQ(verdict(plan), PlanReject::count);
  }
}

TEST(Check, AnotherRobotsPlanIsRefused) {
  for (const std::uint32_t joints : {0U, 1U, 3U, 32U, 0xFFFFFFFFU}) {
    wire::Plan plan = good();
    plan.joint_count = joints;
    EXPECT_EQ(verdict(plan), PlanReject::joints);
  }
}

TEST(Check, WhatIsNotANumberIsRefused) {
  for (const double bad : {kNan, kInf, -kInf}) {
    wire::Plan plan = good();
    plan.position_rad[2 * wire::kNj + 1] = bad;
    EXPECT_EQ(verdict(plan), PlanReject::not_finite);
  }
  wire::Plan plan = good();
  plan.velocity_rad_s[1] = -kInf;
  EXPECT_EQ(verdict(plan), PlanReject::not_finite);
}

TEST(Check, UnusedJointsAndWaypointsAreNotLookedAt) {
  wire::Plan plan = good();
  plan.position_rad[2] = kNan;
  plan.position_rad[3 * wire::kNj] = kNan;
  plan.t_ns[3] = 0;
  EXPECT_EQ(verdict(plan), PlanReject::none);
}

TEST(Check, TimeThatStandsStillOrGoesBackwardsIsRefused) {
  wire::Plan plan = good();
  plan.t_ns[1] = plan.t_ns[2];
  EXPECT_EQ(verdict(plan), PlanReject::time_order);
  plan.t_ns[1] = plan.t_ns[2] + 1;
  EXPECT_EQ(verdict(plan), PlanReject::time_order);
}

TEST(Check, APlanThatIsOverOrFarAwayIsRefused) {
  EXPECT_EQ(verdict(make_plan({{-300, 0.1}, {0, 0.1}}, false, 2)), PlanReject::too_old);
  EXPECT_EQ(verdict(make_plan({{-10'001, 0.1}, {100, 0.1}}, false, 2)), PlanReject::too_old);
  EXPECT_EQ(verdict(make_plan({{100, 0.1}, {10'001, 0.1}}, false, 2)), PlanReject::too_far);
  wire::Plan plan = good();
  plan.t_ns[0] = std::numeric_limits<std::int64_t>::min();
  EXPECT_EQ(verdict(plan), PlanReject::too_old);
  plan = good();
  plan.t_ns[2] = std::numeric_limits<std::int64_t>::max();
  EXPECT_EQ(verdict(plan), PlanReject::too_far);
}

TEST(Check, WaypointsOutsideThePositionLimitsAreRefused) {
  wire::Plan plan = good();
  plan.position_rad[2 * wire::kNj + 1] = 3.001;
  EXPECT_EQ(verdict(plan), PlanReject::position_limit);
  EXPECT_EQ(verdict(make_plan({{1000, 3.0}}, false, 2)), PlanReject::none);
}

TEST(Check, VelocitiesBeyondTheLimitAreRefusedGivenOrImplied) {
  EXPECT_EQ(verdict(make_plan({{100, 0.1, 30.1}, {200, 0.1}}, false, 2)), PlanReject::velocity_limit);
  EXPECT_EQ(verdict(make_plan({{200, 0.0}, {210, 0.31}}, false, 2)), PlanReject::velocity_limit);
  EXPECT_EQ(verdict(make_plan({{200, 0.0}, {210, 0.29}}, true, 2)), PlanReject::none);
  EXPECT_EQ(verdict(make_plan({{60, 2.9}}, false, 2)), PlanReject::velocity_limit);
}

// Random bytes, and valid plans with random damage: they are refused, or followed within the limits.
TEST(Check, HostileBytesNeverBringTheSetpointOutOfItsLimits) {
  std::mt19937_64 random(8);
  Bench bench(robot_with(kMaxJoints));
  int accepted = 0;
  double t = 0;
  for (int round = 0; round < 20'000; ++round) {
    const double level = static_cast<double>(random() % 500) / 100 - 2.5;
    wire::Plan plan =
        make_plan({{t + 70, level}, {t + 200, level}, {t + 330, -level / 9}}, random() % 2 == 0, kMaxJoints);
    auto* bytes = reinterpret_cast<unsigned char*>(&plan);
    const std::size_t hits = round % 10 == 0 ? sizeof plan : random() % 8;
    for (std::size_t i = 0; i < hits; ++i) bytes[random() % sizeof plan] = static_cast<unsigned char>(random());
    if (round % 3 == 0)
      plan.t_ns[0] = kStart + static_cast<std::int64_t>(t * 1e6) + static_cast<std::int64_t>(random() % 7);
    accepted += bench.accept(plan, t) == PlanReject::none ? 1 : 0;
    for (int i = 0; i < 3; ++i) {
      const Setpoint setpoint = bench.at(t);
      for (std::size_t j = 0; j < kMaxJoints; ++j) {
        ASSERT_TRUE(setpoint.position_rad[j] >= -3 && setpoint.position_rad[j] <= 3) << round;
        ASSERT_TRUE(std::isfinite(setpoint.velocity_rad_s[j]) && std::isfinite(setpoint.acceleration_rad_s2[j]));
      }
      t += static_cast<double>(random() % 100);
    }
  }
  EXPECT_GT(accepted, 1000);
}

}  // namespace
}  // namespace lithe::plan
