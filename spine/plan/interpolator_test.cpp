// SPDX-License-Identifier: Apache-2.0
#include "spine/plan/interpolator.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include "spine/core/test/no_alloc_rig.hpp"
#include "spine/plan/test/plan_rig.hpp"

namespace lithe::plan {
namespace {

using wire::PlanReject;
using wire::PlanState;

TEST(Interpolator, BeforeAnythingItHoldsWhereItWasToldTo) {
  Interpolator fresh;
  fresh.configure(robot_with(1));
  EXPECT_EQ(fresh.sample(kStart).state, PlanState::none);
  Bench bench(robot_with(1), 0.7);
  EXPECT_EQ(bench.at(0).position_rad[0], 0.7);
  EXPECT_EQ(bench.at(5000).velocity_rad_s[0], 0.0);
  EXPECT_EQ(bench.at(5000).state, PlanState::hold);
  EXPECT_EQ(bench.interpolator.plan_id(), 0U);
}

TEST(Interpolator, HoldingStaysWithinTheLimitsAndIgnoresNotANumber) {
  Bench bench(robot_with(1), 9.0);
  EXPECT_EQ(bench.at(0).position_rad[0], 3.0);
  JointArray unknown{};
  unknown.fill(kNan);
  bench.interpolator.hold_at(unknown);
  EXPECT_EQ(bench.at(0).position_rad[0], 3.0);
}

TEST(Interpolator, WaypointsAreMetExactlyAtTheirTimes) {
  Bench bench;
  const std::vector<Waypoint> waypoints{{100, 0.3}, {137, 0.5}, {160, 0.2}, {200, 0.4}};
  ASSERT_EQ(bench.accept(make_plan(waypoints), 0), PlanReject::none);
  for (const Waypoint& w : waypoints) EXPECT_NEAR(bench.at(w.t_ms).position_rad[0], w.position_rad, 1e-12);
}

TEST(Interpolator, GivenVelocitiesAreUsedExactly) {
  Bench bench;
  const std::vector<Waypoint> waypoints{{100, 0.3, 1.5}, {150, 0.5, -2.0}, {200, 0.4, 0.25}, {260, 0.5}};
  ASSERT_EQ(bench.accept(make_plan(waypoints), 0), PlanReject::none);
  for (std::size_t i = 0; i < 3; ++i)
    EXPECT_NEAR(bench.at(waypoints[i].t_ms).velocity_rad_s[0], waypoints[i].velocity_rad_s, 1e-9);
}

TEST(Interpolator, AGoToIsOneSmoothMoveThatArrivesOnTime) {
  Bench bench;
  ASSERT_EQ(bench.accept(make_plan({{500, 1.0}}), 0), PlanReject::none);
  EXPECT_EQ(bench.at(0).position_rad[0], 0.0);
  EXPECT_NEAR(bench.at(250).position_rad[0], 0.5, 1e-9);
  EXPECT_EQ(bench.at(250).state, PlanState::track);
  EXPECT_NEAR(bench.at(250).velocity_rad_s[0], 3.0, 1e-9);  // 1.5 times the mean
  EXPECT_NEAR(bench.at(499).position_rad[0], 1.0, 1e-3);
  const Setpoint end = bench.at(500);
  EXPECT_NEAR(end.position_rad[0], 1.0, 1e-12);
  EXPECT_EQ(end.velocity_rad_s[0], 0.0);
  EXPECT_EQ(end.state, PlanState::hold);
}

// A sine of 0.5 Hz and 0.6 rad as a Brain streams it: every 20 ms a plan with points 20 ms apart, the first `behind` of
// them in the past; negative: so many later than the next. Returns how far the acceleration is from the sine's, at
// worst, once it follows [rad/s^2].
double worst_acceleration_of_a_stream(int behind) {
  const double rad_s = std::numbers::pi, rad = 0.6;
  Bench bench;
  double worst = 0;
  for (int t_ms = 0; t_ms < 4000; ++t_ms) {
    if (t_ms % 20 == 3) {
      std::vector<Waypoint> points;
      for (int i = 1 - behind; i <= 12; ++i) {
        const double at_ms = 20 * (t_ms / 20 + i);
        points.push_back({at_ms, rad * std::sin(rad_s * at_ms * 1e-3)});
      }
      EXPECT_EQ(bench.accept(make_plan(points, true), t_ms), PlanReject::none) << t_ms;
    }
    const double truth = -rad * rad_s * rad_s * std::sin(rad_s * t_ms * 1e-3);
    const double seen = bench.at(t_ms).acceleration_rad_s2[0];
    if (t_ms > 1000) worst = std::max(worst, std::abs(seen - truth));
  }
  return worst;
}

TEST(Interpolator, AStreamHasTheAccelerationOfItsCurveAlsoWherePlansBeginAhead) {
  EXPECT_LT(worst_acceleration_of_a_stream(2), 0.1 * 5.92);
  EXPECT_LT(worst_acceleration_of_a_stream(0), 0.15 * 5.92);
  EXPECT_LT(worst_acceleration_of_a_stream(-1), 0.1 * 5.92);
}

// Backwards the first arc of this one would be 4.5 times as hard as the plan itself.
TEST(Interpolator, AheadOfAPlanIsNothingMuchHarderThanThePlan) {
  Bench bench;
  ASSERT_EQ(bench.accept(make_plan({{1, 0.0, 2.0}, {1000, 2.0, 2.0}}, true), 0), PlanReject::none);
  for (double t = 1; t < 700; ++t) bench.at(t);
  const auto at = bench.at(700).position_rad[0];
  ASSERT_EQ(
      bench.accept(make_plan({{750, at + 0.03, 0.0}, {755, at + 0.0301667, 0.075}, {760, at + 0.0307917, 0.175}}, true),
                   700),
      PlanReject::none);
  double hardest = 0;
  for (double t = 700; t < 760; ++t) hardest = std::max(hardest, std::abs(bench.at(t).acceleration_rad_s2[0]));
  EXPECT_LT(hardest, 65);
}

TEST(Interpolator, APlanAheadStartsFromThePresentMotionWithoutABump) {
  Bench bench;
  Trace trace{0.1, {}, {}, {}};
  ASSERT_EQ(bench.accept(make_plan({{100, 0.5}, {200, 0.6}, {300, 0.0}}), 0), PlanReject::none);
  for (double t = 0; t < 600; t += trace.step_ms) {
    if (std::abs(t - 150.0) < 0.01) ASSERT_EQ(bench.accept(make_plan({{250, -0.2}, {400, 0.1}}), t), PlanReject::none);
    trace.add(bench.at(t));
  }
  EXPECT_LT(Trace::largest_step(trace.position), 0.002);
  EXPECT_LT(Trace::largest_step(trace.velocity), 0.05);
}

TEST(Interpolator, PositionAndVelocityAreContinuousOverEveryKnotAndState) {
  Bench bench;
  const wire::Plan plan = make_plan({{60, 0.1}, {80, 0.3}, {115, 0.2}, {120, 0.21}, {160, -0.3}, {200, 0.4}}, true);
  ASSERT_EQ(bench.accept(plan, 0), PlanReject::none);
  Trace trace{0.1, {}, {}, {}};
  for (double t = 0; t < 1500; t += trace.step_ms) trace.add(bench.at(t));
  double peak = 0;
  for (const double a : trace.acceleration) peak = std::max(peak, std::abs(a));
  EXPECT_LE(Trace::largest_step(trace.velocity), peak * 1e-4 * 1.01);  // no more than the acceleration causes
  EXPECT_LT(trace.velocity_mismatch(), peak * 1e-4);
}

TEST(Interpolator, ACurveThatOvershootsIsClampedToTheLimits) {
  Bench bench(robot_with(1), 2.9);
  ASSERT_EQ(bench.accept(make_plan({{100, 2.0}, {200, 3.0}, {300, 3.0}, {400, 2.0}}), 0), PlanReject::none);
  double highest = 0;
  for (double t = 0; t < 500; ++t) {
    const Setpoint s = bench.at(t);
    highest = std::max(highest, s.position_rad[0]);
    if (s.position_rad[0] == 3.0) EXPECT_LE(s.velocity_rad_s[0], 0.0);
  }
  EXPECT_EQ(highest, 3.0);
}

TEST(Interpolator, PointsInThePastAreSkipped) {
  Bench bench;
  ASSERT_EQ(bench.accept(make_plan({{-500, 0.5}, {-20, 0.1}, {20, 0.1}, {60, 0.5}, {100, 0.9}}), 0), PlanReject::none);
  EXPECT_NEAR(bench.at(60).position_rad[0], 0.5, 0.1);
  EXPECT_NEAR(bench.at(600).position_rad[0], 0.9, 1e-9);
}

TEST(Interpolator, UnderrunCoastsForExactlyTheStoppingDistanceThenHolds) {
  Bench bench;
  ASSERT_EQ(bench.accept(make_plan({{60, 0.0}, {100, 0.1, 2.0}}, true), 0), PlanReject::none);
  EXPECT_EQ(bench.at(99).state, PlanState::track);
  EXPECT_EQ(bench.at(150).state, PlanState::coast);
  EXPECT_NEAR(bench.at(150).velocity_rad_s[0], 1.0, 1e-9);  // 20 rad/s2 for 50 ms
  EXPECT_NEAR(bench.at(150).acceleration_rad_s2[0], -20.0, 1e-9);
  EXPECT_EQ(bench.at(199).state, PlanState::coast);
  const Setpoint end = bench.at(201);
  EXPECT_EQ(end.state, PlanState::hold);
  EXPECT_NEAR(end.position_rad[0], 0.1 + 2.0 * 2.0 / (2 * 20), 1e-12);  // v^2 / 2a
  EXPECT_EQ(end.velocity_rad_s[0], 0.0);
  EXPECT_EQ(bench.at(9000).position_rad[0], end.position_rad[0]);
}

TEST(Interpolator, CoastingBrakesHarderOnlyWhereALimitIsNear) {
  Bench bench(robot_with(1), 2.7);
  ASSERT_EQ(bench.accept(make_plan({{60, 2.75}, {100, 2.9, 4.0}}, true), 0), PlanReject::none);
  Trace trace{0.1, {}, {}, {}};
  for (double t = 100; t < 400; t += trace.step_ms) trace.add(bench.at(t));
  EXPECT_NEAR(trace.position.back(), 3.0, 1e-9);
  EXPECT_LT(Trace::largest_step(trace.velocity), 0.01);  // 80 rad/s2, and no velocity step at the limit
}

TEST(Interpolator, AFinishedPlanEndsAtRest) {
  Bench bench;
  ASSERT_EQ(bench.accept(make_plan({{60, 0.0}, {100, 0.1}, {140, 0.3}}), 0), PlanReject::none);
  const Setpoint end = bench.at(140);
  EXPECT_EQ(end.velocity_rad_s[0], 0.0);
  EXPECT_EQ(end.state, PlanState::hold);
}

TEST(Interpolator, StopBringsAMotionToRestFromWhereItIs) {
  Bench bench;
  bench.interpolator.stop(kStart);
  EXPECT_EQ(bench.at(0).state, PlanState::hold);
  ASSERT_EQ(bench.accept(make_plan({{500, 1.0}}), 0), PlanReject::none);
  const Setpoint before = bench.at(250);
  bench.interpolator.stop(kStart + 250 * kMs);
  const Setpoint after = bench.at(250);
  EXPECT_NEAR(after.position_rad[0], before.position_rad[0], 1e-12);
  EXPECT_NEAR(after.velocity_rad_s[0], 3.0, 1e-9);
  EXPECT_NEAR(bench.at(1000).position_rad[0], 0.5 + 3.0 * 3.0 / 40, 1e-9);
  EXPECT_EQ(bench.at(1000).state, PlanState::hold);
}

TEST(Interpolator, JointsAreIndependent) {
  robot::RobotConfig robot = robot_with(3);
  robot.joints[1].monotone = true;
  Bench bench(robot);
  wire::Plan plan = make_plan({{100, 0.0}, {200, 1.0}, {300, 1.0}}, false, 3);
  plan.position_rad[wire::kNj + 2] = -1.0;
  ASSERT_EQ(bench.accept(plan, 0), PlanReject::none);
  double highest[2] = {0, 0};
  for (double t = 0; t < 300; ++t)
    for (std::size_t j = 0; j < 2; ++j) highest[j] = std::max(highest[j], bench.at(t).position_rad[j]);
  EXPECT_GT(highest[0], 1.01);
  EXPECT_LE(highest[1], 1.0);
  EXPECT_NEAR(bench.at(400).position_rad[2], 1.0, 1e-12);
}

TEST(Interpolator, ARefusedPlanChangesNothing) {
  Bench bench;
  ASSERT_EQ(bench.accept(make_plan({{500, 1.0}}), 0), PlanReject::none);
  Bench twin = bench;
  wire::Plan bad = make_plan({{300, 0.2}, {200, 0.3}});
  bad.plan_id = 2;
  EXPECT_EQ(bench.accept(bad, 100), PlanReject::time_order);
  EXPECT_EQ(bench.accept(make_plan({{160, -2.9}}), 100), PlanReject::velocity_limit);  // impossible to be there in time
  EXPECT_EQ(bench.interpolator.plan_id(), 1U);
  for (double t = 100; t < 700; t += 7) {
    EXPECT_EQ(bench.at(t).position_rad[0], twin.at(t).position_rad[0]);
    EXPECT_EQ(bench.at(t).velocity_rad_s[0], twin.at(t).velocity_rad_s[0]);
  }
}

TEST(Interpolator, NothingIsAllocatedInTheTick) {
  Bench bench(robot_with(kMaxJoints));
  const wire::Plan plan = make_plan({{10, 0.01}, {30, 0.02}, {50, 0.01}}, true, kMaxJoints);
  const NoAllocScope scope;
  (void)bench.interpolator.accept(plan, kStart);
  for (std::int64_t t = 0; t < 200; ++t) (void)bench.interpolator.sample(kStart + t * kMs);
  bench.interpolator.stop(kStart + 200 * kMs);
}

}  // namespace
}  // namespace lithe::plan
