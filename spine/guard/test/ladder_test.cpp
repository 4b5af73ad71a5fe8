// SPDX-License-Identifier: Apache-2.0
// Power, soft start, and the rungs below the safe law.
#include <gtest/gtest.h>

#include <cmath>

#include "spine/guard/test/guard_rig.hpp"

namespace lithe::guard {
namespace {

namespace flag = wire::telemetry_flag;

TEST(GuardPower, WhatDrivesAJointIsBoundedAndWhatBrakesItIsNot) {
  robot::RobotConfig robot = robot_with(1);
  robot.joints[0].power_max_w = 2;
  Bench bench(robot);
  bench.torque[0] = 0.9;
  bench.velocity[0] = 5;
  EXPECT_EQ(bench.settle().flags, flag::kPowerClamped);
  EXPECT_NEAR(bench.felt_nm() * bench.velocity[0], 2, 1e-9);
  bench.velocity[0] = -5;
  EXPECT_EQ(bench.settle().flags, 0U);
  EXPECT_NEAR(bench.felt_nm(), 0.9, 1e-9) << "4.5 W out of the joint";
  bench.velocity[0] = 1;
  EXPECT_EQ(bench.settle().flags, 0U);
  EXPECT_NEAR(bench.felt_nm(), 0.9, 1e-9);
  // The limit is for the whole torque, including the drive's own PD.
  bench.torque[0] = 0;
  bench.velocity[0] = 5;
  bench.position_target[0] = 1;
  bench.kp[0] = 50;
  EXPECT_NE(bench.settle().flags & flag::kPowerClamped, 0U);
  EXPECT_LE(bench.felt_nm() * bench.velocity[0], 2 + 1e-9);
}

TEST(GuardPower, AnyTorqueAndSpeedStayWithinEveryLimit) {
  robot::RobotConfig robot = robot_with(1);
  robot.joints[0].power_max_w = 2;
  for (double torque = -2; torque <= 2; torque += 0.25) {
    for (double velocity = -9; velocity <= 9; velocity += 0.5) {
      Bench bench(robot);
      bench.torque[0] = torque;
      bench.velocity[0] = velocity;
      bench.settle();
      EXPECT_LE(bench.felt_nm() * velocity, 2 + 1e-9) << torque << " at " << velocity;
      EXPECT_LE(std::abs(bench.felt_nm()), 1 + 1e-9);
    }
  }
}

TEST(GuardSoftStart, TheTorqueLimitsGrowFromZeroAfterEachArming) {
  robot::RobotConfig robot = robot_with(1);
  robot.guard.soft_start_s = 0.1;
  Bench bench(robot);
  bench.torque[0] = 1;
  for (int round = 0; round < 2; ++round) {
    double before_nm = 0;
    for (int tick = 1; tick <= 100; ++tick) {
      const Verdict verdict = bench.check();
      EXPECT_NEAR(bench.felt_nm(), tick / 100.0, 1e-9);
      EXPECT_NEAR(bench.out.max_torque_nm[0], tick / 100.0, 1e-9) << "the drive's own limit, if this command stays";
      EXPECT_EQ((verdict.flags & flag::kSoftStarting) != 0, tick < 100) << tick;
      EXPECT_GT(bench.felt_nm(), before_nm);
      before_nm = bench.felt_nm();
    }
    EXPECT_EQ(bench.check().flags, 0U);
    bench.guard.reset_output();
  }
}

TEST(GuardSoftStart, TheSafeLawHasAllTheTorqueThereIs) {
  robot::RobotConfig robot = robot_with(1);
  robot.guard.soft_start_s = 10;
  Bench bench(robot);
  bench.check();
  bench.velocity[0] = 8;
  bench.mode = wire::Mode::safe_stop;
  bench.settle();
  EXPECT_GT(std::abs(bench.felt_nm()), 0.5);
}

TEST(GuardLadder, AtRestTheDrivesBrakeAndThenAreOff) {
  robot::RobotConfig robot = robot_with(2);
  robot.guard.brake_after_s = 0.05;
  robot.guard.off_after_s = 0.08;
  Bench bench(robot);
  EXPECT_EQ(bench.rung_after(1), Rung::law);
  bench.mode = wire::Mode::safe_stop;
  bench.velocity[1] = 1;
  EXPECT_EQ(bench.rung_after(200), Rung::safe_law) << "one joint still moves";
  bench.velocity[1] = 0;
  EXPECT_EQ(bench.rung_after(50), Rung::safe_law);
  EXPECT_EQ(bench.rung_after(1), Rung::brake);
  EXPECT_EQ(bench.out.torque_nm[0], 0);
  bench.velocity[1] = 3;
  EXPECT_EQ(bench.rung_after(200), Rung::brake)
      << "after a push it still brakes, and nothing that moves is switched off";
  bench.velocity[1] = 0;
  EXPECT_EQ(bench.rung_after(80), Rung::brake);
  EXPECT_EQ(bench.rung_after(1), Rung::off);
  bench.velocity[1] = 3;
  EXPECT_EQ(bench.rung_after(100), Rung::off) << "no torque on it any more";
  bench.guard.reset_output();
  bench.velocity[1] = 0;
  bench.mode = wire::Mode::active;
  EXPECT_EQ(bench.rung_after(1), Rung::law) << "after a person's reset";
}

TEST(GuardLadder, WithoutARungTheSafeLawGoesOnForEver) {
  Bench bench(robot_with(1));
  bench.mode = wire::Mode::safe_stop;
  EXPECT_EQ(bench.rung_after(100'000), Rung::safe_law);
  robot::RobotConfig robot = robot_with(1);
  robot.guard.off_after_s = 0.01;
  Bench off(robot);
  off.mode = wire::Mode::safe_stop;
  EXPECT_EQ(off.rung_after(11), Rung::off) << "without the rung brake in between";
}

// Its drive may damp it while it sinks: a brake that slips, or a drive that is heard again and reports "off".
TEST(GuardLadder, NothingIsLetGoWhileAJointIsUnseen) {
  robot::RobotConfig robot = robot_with(2);
  robot.guard.brake_after_s = 0.02;
  robot.guard.off_after_s = 0.05;
  Bench bench(robot);
  bench.mode = wire::Mode::safe_stop;
  bench.status[0] = wire::joint_status::kLost;
  EXPECT_EQ(bench.rung_after(1000), Rung::brake);
  bench.status[0] = 0;
  bench.velocity[0] = 4;
  EXPECT_EQ(bench.rung_after(1000), Rung::brake) << "heard again, and falling";
  bench.velocity[0] = 0;
  EXPECT_EQ(bench.rung_after(51), Rung::off);
}

TEST(GuardLadder, AJointNobodyHearsOfDoesNotKeepTheOthersFromBraking) {
  robot::RobotConfig robot = robot_with(2);
  robot.guard.brake_after_s = 0.05;
  Bench bench(robot);
  bench.mode = wire::Mode::safe_stop;
  bench.status[0] = wire::joint_status::kLost;
  bench.velocity[0] = 9;
  EXPECT_EQ(bench.rung_after(60), Rung::brake);
}

}  // namespace
}  // namespace lithe::guard
