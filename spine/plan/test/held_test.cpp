// SPDX-License-Identifier: Apache-2.0
// Held plans: the setpoint is that of the definition, tick by tick.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <optional>
#include <random>
#include <vector>

#include "spine/plan/interpolator.hpp"
#include "spine/plan/test/plan_rig.hpp"

namespace lithe::plan {
namespace {

using wire::PlanReject;
using wire::PlanState;

constexpr double kStaleMs = 250;  // [brain] stale_after_s of robot_with()

wire::Plan held(const std::vector<Waypoint>& waypoints) {
  wire::Plan plan = make_plan(waypoints);
  plan.interpolation = static_cast<std::uint32_t>(wire::Interpolation::hold);
  return plan;
}

TEST(Held, TheSetpointStepsAtEachTimeAndStaysThere) {
  Bench bench(robot_with(1), 0.1);
  ASSERT_EQ(bench.accept(held({{10, 2.0}, {30, -2.5, 1.5}}), 0), PlanReject::none);
  EXPECT_EQ(bench.at(9.999).position_rad[0], 0.1);
  EXPECT_EQ(bench.interpolator.held_for_ns(kStart + 9 * kMs), -1);
  EXPECT_EQ(bench.at(10).position_rad[0], 2.0);
  EXPECT_TRUE(bench.interpolator.setpoint().steps);
  EXPECT_EQ(bench.at(29.999).position_rad[0], 2.0);
  EXPECT_FALSE(bench.interpolator.setpoint().steps);
  EXPECT_EQ(bench.at(29.999).velocity_rad_s[0], 0.0);
  EXPECT_EQ(bench.interpolator.held_for_ns(kStart + 29 * kMs), 19 * kMs);
  EXPECT_EQ(bench.at(30).position_rad[0], -2.5);
  EXPECT_EQ(bench.at(30).velocity_rad_s[0], 1.5);
  EXPECT_EQ(bench.at(30).acceleration_rad_s2[0], 0.0);
  EXPECT_EQ(bench.at(30 + kStaleMs - 1).state, PlanState::track);
  const Setpoint stale = bench.at(30 + kStaleMs);
  EXPECT_EQ(stale.state, PlanState::hold);
  EXPECT_EQ(stale.position_rad[0], -2.5);
  EXPECT_EQ(stale.velocity_rad_s[0], 0.0);
  EXPECT_EQ(bench.interpolator.held_for_ns(kStart + 9000 * kMs), 8970 * kMs);
}

TEST(Held, AWaypointThatHasPassedStepsAtOnceUnlessItIsStale) {
  Bench bench;
  ASSERT_EQ(bench.accept(held({{-500, 1.0}, {-20, 2.0}}), 0), PlanReject::none);
  EXPECT_EQ(bench.at(0).position_rad[0], 2.0);
  EXPECT_EQ(bench.interpolator.held_for_ns(kStart), 20 * kMs);
  const wire::PlanDecision old = bench.decide(held({{5, 1.0}}), 5 + kStaleMs);
  EXPECT_EQ(reason_of(old), PlanReject::too_old);
  EXPECT_DOUBLE_EQ(old.value, -0.25);
  EXPECT_DOUBLE_EQ(old.limit, -0.25);
  EXPECT_EQ(bench.accept(make_plan({{5, 1.0}}), 6), PlanReject::too_old);  // a curve needs a waypoint ahead
  EXPECT_EQ(bench.at(6).position_rad[0], 2.0);
}

TEST(Held, OnlyTheStepMayBeOfAnySize) {
  Bench bench;
  EXPECT_EQ(bench.accept(make_plan({{1, -3.0}, {2, 3.0}}), 0), PlanReject::velocity_limit);
  EXPECT_EQ(bench.accept(held({{1, -3.0}, {2, 3.0}}), 0), PlanReject::none);
  const wire::PlanDecision beyond = bench.decide(held({{1, 0.0}, {2, 3.1}}), 0);
  EXPECT_EQ(reason_of(beyond), PlanReject::position_limit);
  EXPECT_EQ(beyond.waypoint, 1U);
  EXPECT_EQ(bench.accept(held({{1, 0.0, 31.0}}), 0), PlanReject::velocity_limit);
  EXPECT_EQ(bench.accept(held({{1, kNan}}), 0), PlanReject::not_finite);
  EXPECT_EQ(bench.accept(held({{1, 0.0, INFINITY}}), 0), PlanReject::not_finite);
  EXPECT_EQ(bench.at(2).position_rad[0], 3.0);  // the plan before goes on
}

TEST(Held, FromACurveToHeldTheSetpointSlowsDownUntilTheFirstWaypoint) {
  Bench bench;
  ASSERT_EQ(bench.accept(make_plan({{1, 0.0, 2.0}, {1000, 2.0, 2.0}}, true), 0), PlanReject::none);
  const double from_rad = bench.at(700).position_rad[0], from_rad_s = bench.at(700).velocity_rad_s[0];
  ASSERT_EQ(bench.accept(held({{1100, -1.0}}), 700), PlanReject::none);
  EXPECT_EQ(bench.at(700).state, PlanState::coast);
  EXPECT_NEAR(bench.at(1099).position_rad[0], from_rad + from_rad_s * from_rad_s / (2 * 20), 1e-9);
  EXPECT_EQ(bench.at(1099).state, PlanState::hold);
  EXPECT_EQ(bench.at(1100).position_rad[0], -1.0);
  EXPECT_EQ(bench.at(1100).state, PlanState::track);
}

TEST(Held, FromHeldToACurveTheSetpointLeavesFromRest) {
  Bench bench;
  ASSERT_EQ(bench.accept(held({{0, 1.0, 2.0}, {50, 3.0}}), 0), PlanReject::none);
  EXPECT_EQ(bench.at(10).velocity_rad_s[0], 2.0);
  ASSERT_EQ(bench.accept(make_plan({{510, 2.0}}), 10), PlanReject::none);
  Trace trace;
  for (int t_ms = 10; t_ms <= 520; ++t_ms) trace.add(bench.at(t_ms));
  EXPECT_EQ(trace.position.front(), 1.0);
  EXPECT_EQ(trace.velocity.front(), 0.0);
  EXPECT_LT(Trace::largest_step(trace.position), 3.1e-3);  // 1.5 times the mean speed of 2 rad/s: no step to 3.0
  EXPECT_NEAR(trace.position.back(), 2.0, 1e-12);
  EXPECT_EQ(bench.interpolator.held_for_ns(kStart + 520 * kMs), -1);
}

TEST(Held, StopKeepsTheValueAndDropsTheStepsAhead) {
  Bench bench;
  ASSERT_EQ(bench.accept(held({{0, 1.0, 2.0}, {50, 3.0}}), 0), PlanReject::none);
  bench.at(10);
  bench.interpolator.stop(kStart + 10 * kMs);
  for (const double t_ms : {10.0, 49.0, 51.0, 500.0}) {
    EXPECT_EQ(bench.at(t_ms).position_rad[0], 1.0);
    EXPECT_EQ(bench.at(t_ms).velocity_rad_s[0], 0.0);
    EXPECT_EQ(bench.at(t_ms).state, PlanState::hold);
  }
}

TEST(Held, WhatIsLeftOfAStepFadesButNoFasterThanTheJointCouldGo) {
  robot::RobotConfig robot = robot_with(1);
  robot.joints[0].velocity_max_rad_s = 2;
  Bench bench(robot);
  ASSERT_EQ(bench.accept(held({{1, 2.0}}), 0), PlanReject::none);
  for (int t_ms = 0; t_ms <= 1; ++t_ms) bench.at(t_ms);
  EXPECT_EQ(bench.interpolator.setpoint().stepped_rad[0], 2.0);
  EXPECT_EQ(bench.interpolator.setpoint().step_rad_s[0], 2.0 / 0.05);
  for (int t_ms = 2; t_ms <= 1001; ++t_ms) bench.at(t_ms);
  EXPECT_NEAR(bench.interpolator.setpoint().stepped_rad[0], 1.0, 1e-9);  // half of 2 rad/s, for a second
  for (int t_ms = 1002; t_ms <= 6001; ++t_ms) bench.at(t_ms);
  EXPECT_LT(bench.interpolator.setpoint().stepped_rad[0], 1e-3);
  for (int t_ms = 6002; t_ms <= 20'000; ++t_ms) bench.at(t_ms);
  EXPECT_EQ(bench.interpolator.setpoint().stepped_rad[0], 0.0) << "not denormal in the end";
  EXPECT_EQ(bench.interpolator.setpoint().step_rad_s[0], 0.0);
}

TEST(Held, TheSpeedOfManyStepsIsThatOfTheirMotion) {
  Bench bench;
  double least = kNan, most = 0;
  for (int t_ms = 0; t_ms < 1000; ++t_ms) {
    if (t_ms % 20 == 0) ASSERT_EQ(bench.accept(held({{t_ms * 1.0, 0.5e-3 * t_ms}}), t_ms), PlanReject::none);
    const double rad_s = bench.at(t_ms).step_rad_s[0];
    if (t_ms < 500) continue;
    least = std::fmin(least, rad_s);
    most = std::max(most, rad_s);
  }
  EXPECT_NEAR(0.5 * (least + most), 0.5, 0.05);
  EXPECT_LT(most - least, 0.25);
}

// The definition, written down as such: of all waypoints of held plans, in the order in which they came.
class Definition {
 public:
  explicit Definition(double rad) : rad_(rad) {}
  // `at_ms`: of the tick that takes it. Latest wins: what was still ahead is dropped.
  void accept(const std::vector<Waypoint>& waypoints, double at_ms) {
    sample(at_ms);
    ahead_ = waypoints;
  }
  void sample(double at_ms) {
    for (const Waypoint& w : ahead_)
      if (w.t_ms <= at_ms) holds_ = w;
    std::erase_if(ahead_, [&](const Waypoint& w) { return w.t_ms <= at_ms; });
    if (holds_) rad_ = holds_->position_rad;
    fresh_ = holds_ && at_ms - holds_->t_ms < kStaleMs;
  }
  double rad() const { return rad_; }
  double rad_s() const { return fresh_ && !std::isnan(holds_->velocity_rad_s) ? holds_->velocity_rad_s : 0.0; }
  bool fresh() const { return fresh_; }

 private:
  double rad_;
  bool fresh_ = false;
  std::optional<Waypoint> holds_;
  std::vector<Waypoint> ahead_;
};

struct Seen {
  int ticks = 0, differ = 0, steps = 0, stale = 0, refused = 0;
};

// Ten seconds of plans at random times, of 1 to 16 waypoints from the past and the future. `later_ms`: of the twin,
// which reads the clock so much late.
Seen compare(std::uint64_t seed, double later_ms) {
  std::mt19937_64 random(seed);
  const auto between = [&](double from, double to) { return std::uniform_real_distribution(from, to)(random); };
  Bench bench(robot_with(2), 0.5);
  Definition definition(0.5);
  Seen seen;
  double next_ms = 0;
  for (int tick = 0; tick < 10'000; ++tick) {
    const double t_ms = tick;
    if (t_ms >= next_ms) {
      next_ms = t_ms + (between(0, 1) < 0.05 ? 600 : between(1, 40));
      std::vector<Waypoint> waypoints(1 + random() % wire::kNw);
      double at_ms = t_ms + std::round(between(-60, 30));
      for (Waypoint& w : waypoints) {
        w = {at_ms, between(-3, 3), random() % 2 == 0 ? kNan : between(-30, 30)};
        at_ms += std::round(between(1, 30));
      }
      if (random() % 10 == 0) waypoints[random() % waypoints.size()].position_rad = 3.5;
      wire::Plan plan = held(waypoints);
      plan.joint_count = 2;
      for (std::size_t w = 0; w < waypoints.size(); ++w) plan.position_rad[w * wire::kNj + 1] = 0.25;
      if (bench.accept(plan, t_ms) == PlanReject::none)
        definition.accept(waypoints, t_ms);
      else
        ++seen.refused;
    }
    definition.sample(t_ms);
    const Setpoint got = bench.at(t_ms - later_ms);
    const bool fresh = got.state == PlanState::track;
    ++seen.ticks;
    seen.steps += got.steps ? 1 : 0;
    seen.stale += definition.fresh() ? 0 : 1;
    const bool inside = std::abs(definition.rad()) < 3;  // at a limit no velocity leads outwards
    seen.differ += got.position_rad[0] != definition.rad() || fresh != definition.fresh() ||
                           (inside && got.velocity_rad_s[0] != definition.rad_s())
                       ? 1
                       : 0;
  }
  return seen;
}

TEST(Held, RandomPlansGiveTheDefinitionInEveryTick) {
  Seen all;
  for (std::uint64_t seed = 1; seed <= 50; ++seed) {
    const Seen seen = compare(seed, 0);
    EXPECT_EQ(seen.differ, 0) << "seed " << seed;
    all.steps += seen.steps;
    all.stale += seen.stale;
    all.refused += seen.refused;
    all.ticks += seen.ticks;
  }
  EXPECT_EQ(all.ticks, 500'000);
  EXPECT_GT(all.steps, 10'000);
  EXPECT_GT(all.stale, 10'000);
  EXPECT_GT(all.refused, 1'000);
}

TEST(HeldTwin, OneThatStepsATickLateIsSeen) {
  for (std::uint64_t seed = 1; seed <= 10; ++seed) EXPECT_GT(compare(seed, 1).differ, 100) << "seed " << seed;
}

}  // namespace
}  // namespace lithe::plan
