// SPDX-License-Identifier: Apache-2.0
#include "spine/guard/recovery.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "spine/guard/test/guard_rig.hpp"

namespace lithe::guard {
namespace {

using wire::Fault;
using wire::Mode;

constexpr double kCapNm = 0.5, kSlowRadS = 0.3;  // the defaults, of robot_with()'s 1 Nm

robot::RobotConfig quick_robot() {
  robot::RobotConfig robot = robot_with(1);
  robot.joints[0].torque_slew_nm_s = 1e6;  // so that the slew bound has no effect
  return robot;
}

struct Recovering : Bench {
  explicit Recovering(const robot::RobotConfig& robot) : Bench(robot) {
    mode = Mode::recover;
    torque.fill(1000);  // the torque of any law
    guard.start_recovery();
  }
};

TEST(Recovery, OutsideTheLimitsTorqueLeadsInwardsOrBrakesAnInwardMotion) {
  std::mt19937_64 random(3);
  std::uniform_real_distribution<double> far(0.001, 3), speed(-9, 9);
  int inwards = 0, brakes = 0;
  for (int i = 0; i < 20'000; ++i) {
    Recovering bench(quick_robot());
    const double side = i % 2 == 0 ? 1 : -1;
    bench.position[0] = side > 0 ? 3 + far(random) : -2 - far(random);
    bench.velocity[0] = speed(random);
    for (int tick = 0; tick < 4; ++tick) ASSERT_EQ(bench.check().fault, Fault::none);
    const double inward_nm = -side * bench.felt_nm(), inward_rad_s = -side * bench.velocity[0];
    ASSERT_LE(std::abs(inward_nm), kCapNm + 1e-12);
    ASSERT_EQ(bench.out.kp_nm_rad[0], 0);
    if (inward_nm > 0) {
      ASSERT_LT(inward_rad_s, 2 * kSlowRadS);
      ++inwards;
    }
    if (inward_nm < 0) {
      ASSERT_GT(inward_rad_s, 0);
      ASSERT_LE(-inward_nm, kCapNm * inward_rad_s / kSlowRadS + 1e-12);
      ++brakes;
    }
  }
  EXPECT_GT(inwards, 5000);
  EXPECT_GT(brakes, 5000);
}

TEST(Recovery, ItsTorqueStartsFromTheLastOneAndKeepsTheSlewBound) {
  Bench bench;
  bench.torque[0] = 0.9;
  bench.settle();
  ASSERT_NEAR(bench.felt_nm(), 0.9, 1e-9);
  bench.mode = Mode::recover;
  bench.position[0] = 3.5;
  bench.guard.start_recovery();
  double last_nm = bench.felt_nm();
  for (int i = 0; i < 1000; ++i) {
    bench.check();
    ASSERT_LE(std::abs(bench.felt_nm() - last_nm), kSlewPerTick + 1e-12);
    ASSERT_GE(bench.out.max_torque_nm[0], std::abs(bench.felt_nm())) << "the drive's own limit causes no step either";
    last_nm = bench.felt_nm();
  }
  EXPECT_LT(last_nm, 0) << "inwards";
}

TEST(Recovery, PositionIsNoFaultMeanwhileAndAllOthersAre) {
  Recovering bench(quick_robot());
  bench.position[0] = 6;
  EXPECT_EQ(bench.check().fault, Fault::none);
  bench.velocity[0] = 13;  // beyond 1.25 times 10
  const Verdict verdict = bench.check();
  EXPECT_EQ(verdict.fault, Fault::velocity_limit);
  EXPECT_TRUE(verdict.use_safe_law);
  EXPECT_EQ(bench.guard.joint_fault(0), Fault::velocity_limit);
  Recovering lost(quick_robot());
  lost.status[0] = wire::joint_status::kLost;
  EXPECT_EQ(lost.check().fault, Fault::drive_lost);
}

TEST(Recovery, AJointThatDoesNotMoveIsStuckAfterAWhileAndSaysWhy) {
  Recovering bench(quick_robot());
  bench.position[0] = 3.5;
  int ticks = 0;
  Verdict verdict;
  while (verdict.fault == Fault::none && ticks < 20'000) {
    verdict = bench.check();
    ++ticks;
  }
  EXPECT_EQ(verdict.fault, Fault::recover_failed);
  EXPECT_GT(ticks, 2000);
  EXPECT_LT(ticks, 6000);
  EXPECT_EQ(bench.guard.recovery().why_stuck(0), "the recover torque does not move it (load, or a stop)");
}

TEST(Recovery, ARestOnTheStopCountsAsInsideAndNotANumberDoesNot) {
  Recovery recovery;
  recovery.configure(robot_with(1));
  EXPECT_TRUE(recovery.inside(0, 3.005));
  EXPECT_FALSE(recovery.inside(0, 3.02));
  EXPECT_FALSE(recovery.inside(0, -2.02));
  EXPECT_FALSE(recovery.inside(0, kNan));
}

}  // namespace
}  // namespace lithe::guard
