// SPDX-License-Identifier: Apache-2.0
// A plan whose first waypoint ahead is nearer than a blend: refused when the way from the setpoint to it is too fast.
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "spine/plan/test/plan_rig.hpp"

namespace lithe::plan {
namespace {

using wire::PlanReject;

constexpr double kLimitRadS = 3;
constexpr std::size_t kJoints = 2;  // the last one monotone

robot::RobotConfig slow_robot() {
  robot::RobotConfig robot = robot_with(kJoints);
  for (robot::JointConfig& joint : robot.joints) joint.velocity_max_rad_s = kLimitRadS;
  robot.joints[kJoints - 1].monotone = true;
  return robot;
}

Limits limits_of(const robot::RobotConfig& robot) {
  Limits limits;
  limits.joints = robot.joints.size();
  for (std::size_t j = 0; j < limits.joints; ++j) limits.joint[j] = {-3, 3, robot.joints[j].velocity_max_rad_s};
  return limits;
}

double between(std::mt19937_64& random, double low, double high) {
  return std::uniform_real_distribution<double>(low, high)(random);
}

// Of the ways from the setpoint to the first waypoint ahead, the fastest by its limit; computed from the plan alone.
double needed(const wire::Plan& plan, double now_ms, const Setpoint& from) {
  const std::int64_t now_ns = kStart + std::llround(now_ms * 1e6);
  std::size_t w = 0;
  while (plan.t_ns[w] <= now_ns) ++w;
  double most = 0;
  for (std::size_t j = 0; j < kJoints; ++j) {
    const double way_rad = std::abs(plan.position_rad[w * wire::kNj + j] - from.position_rad[j]);
    most = std::max(most, way_rad / (static_cast<double>(plan.t_ns[w] - now_ns) * 1e-9) / kLimitRadS);
  }
  return most;
}

// One or two waypoints within 0.1 to 50 ms, behind none to three that are over: what `go_to` and `publish` send.
wire::Plan near_plan(std::mt19937_64& random, double now_ms, double from_rad) {
  const double first_ms = std::exp(between(random, std::log(0.1), std::log(50.0)));
  const double speed_rad_s = kLimitRadS * between(random, -2, 2);
  const double goal_rad = std::clamp(from_rad + speed_rad_s * first_ms * 1e-3, -3.0, 3.0);
  std::vector<Waypoint> waypoints;
  for (std::uint64_t past = random() % 4; past > 0; --past)
    waypoints.push_back({now_ms - 20.0 * static_cast<double>(past), goal_rad});
  waypoints.push_back({now_ms + first_ms, goal_rad});
  if (random() % 2 == 0) waypoints.push_back({now_ms + first_ms + 100, std::clamp(goal_rad * 0.98, -3.0, 3.0)});
  return make_plan(waypoints, random() % 2 == 0, kJoints);
}

TEST(Near, NoAcceptedPlanNeedsMoreThanTheVelocityLimitFromTheSetpoint) {
  std::mt19937_64 random(21);
  const robot::RobotConfig robot = slow_robot();
  Bench bench(robot);
  int accepted = 0, refused = 0, twin_accepts_too_fast = 0;
  double t_ms = 0;
  for (int round = 0; round < 20'000; ++round) {
    const Setpoint from = bench.at(t_ms);
    const wire::Plan plan = near_plan(random, t_ms, from.position_rad[0]);
    const double share = needed(plan, t_ms, from);
    const wire::PlanDecision decided = bench.decide(plan, t_ms);
    if (reason_of(decided) == PlanReject::none) {
      ++accepted;
      ASSERT_LE(share, 1 + 1e-5) << round;
    } else {
      ++refused;
      ASSERT_EQ(reason_of(decided), PlanReject::velocity_limit) << round;
      ASSERT_GT(decided.value, decided.limit * (1 - 1e-9)) << round;
      ASSERT_LT(decided.joint, kJoints) << round;
      ASSERT_GT(decided.needs_s, 0) << round;
    }
    // The twin looks at the waypoints alone.
    const PlanReject twin = reason_of(check(plan, limits_of(robot), kStart + std::llround(t_ms * 1e6)));
    twin_accepts_too_fast += twin == PlanReject::none && share > 1 + 1e-5 ? 1 : 0;
    t_ms += std::floor(between(random, 1, 120));
  }
  EXPECT_GT(accepted, 3'000);
  EXPECT_GT(refused, 3'000);
  EXPECT_GT(twin_accepts_too_fast, 3'000) << "these plans tell the two apart";
}

// From rest to rest: the time that a refusal names is enough, and not by much more than it has to be.
TEST(Near, TheTimeThatARefusalNamesIsEnough) {
  for (const double in_ms : {0.5, 20.0, 40.0, 49.0, 60.0, 300.0}) {
    Bench bench(slow_robot());
    const wire::PlanDecision decided = bench.decide(make_plan({{in_ms, 2.0}}, false, kJoints), 0);
    ASSERT_EQ(reason_of(decided), PlanReject::velocity_limit) << in_ms;
    EXPECT_EQ(decided.waypoint, 0U);
    EXPECT_NEAR(decided.way_rad, 2.0, 1e-12);
    EXPECT_NEAR(decided.needs_s, 1.0, 1e-9) << "a cubic is 1.5 times as fast as its mean";
    const double enough_ms = decided.needs_s * 1e3 + 1e-3;
    EXPECT_EQ(bench.accept(make_plan({{enough_ms, 2.0}}, false, kJoints), 0), PlanReject::none);
    EXPECT_EQ(bench.accept(make_plan({{enough_ms * 0.99, 2.0}}, false, kJoints), 0), PlanReject::velocity_limit);
  }
}

TEST(Near, PointsInThePastDoNotHideTheWayToTheOneAhead) {
  Bench bench(slow_robot());
  const wire::Plan plan = make_plan({{-40, 2.0}, {-20, 2.0}, {20, 2.0}}, true, kJoints);
  const wire::PlanDecision decided = bench.decide(plan, 0);
  EXPECT_EQ(reason_of(decided), PlanReject::velocity_limit);
  EXPECT_EQ(decided.waypoint, 2U);
  EXPECT_NEAR(decided.value, 100, 1e-6) << "2 rad in 20 ms";
}

// A stream with enough ahead says where it will be: it is caught up with.
TEST(Near, AStreamWithThreeWaypointsAheadIsCaughtUpWith) {
  Bench bench(slow_robot());
  EXPECT_EQ(bench.accept(make_plan({{20, 2.0}, {40, 2.0}, {60, 2.0}}, true, kJoints), 0), PlanReject::none);
  EXPECT_EQ(bench.accept(make_plan({{20, 2.0}, {40, 2.0}, {60, 2.0}}, false, kJoints), 0), PlanReject::velocity_limit);
}

}  // namespace
}  // namespace lithe::plan
