// SPDX-License-Identifier: Apache-2.0
#include "spine/guard/guard.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "spine/core/test/no_alloc_rig.hpp"
#include "spine/guard/test/guard_rig.hpp"

namespace lithe::guard {
namespace {

using wire::Fault;
using wire::Mode;
namespace flag = wire::telemetry_flag;

constexpr double kInf = std::numeric_limits<double>::infinity();
constexpr double kRounding = 1.0e-12;

TEST(Guard, AProposalWithinTheLimitsPassesUntouched) {
  Bench bench;
  bench.torque[0] = 0.05;
  const Verdict verdict = bench.check();
  EXPECT_EQ(bench.out.torque_nm[0], 0.05);
  EXPECT_TRUE(std::isnan(bench.out.position_rad[0]));
  EXPECT_EQ(bench.out.max_torque_nm[0], 1.0);
  EXPECT_EQ(verdict.flags, 0U);
  EXPECT_EQ(verdict.fault, Fault::none);
  EXPECT_FALSE(verdict.use_safe_law);
}

TEST(Guard, TorqueIsClampedAndCounted) {
  Bench bench;
  bench.torque[0] = -7;
  const Verdict verdict = bench.settle();
  EXPECT_EQ(bench.out.torque_nm[0], -1.0);
  EXPECT_EQ(verdict.flags, flag::kTorqueClamped);
}

TEST(Guard, TorqueChangesAtMostBySlewPerTick) {
  Bench bench;
  bench.torque[0] = 0.35;
  EXPECT_EQ(bench.check().flags, flag::kSlewClamped);
  EXPECT_NEAR(bench.out.torque_nm[0], 0.1, kRounding);
  bench.check();
  bench.check();
  EXPECT_NEAR(bench.out.torque_nm[0], 0.3, kRounding);
  EXPECT_EQ(bench.check().flags, 0U);
  EXPECT_NEAR(bench.out.torque_nm[0], 0.35, kRounding);
}

TEST(Guard, ArmingStartsFromDrivesThatAreOff) {
  Bench bench;
  bench.torque[0] = 0.85;
  bench.settle();
  bench.guard.reset_output();
  bench.check();
  EXPECT_NEAR(bench.out.torque_nm[0], kSlewPerTick, kRounding);
}

TEST(Guard, NotANumberIsReplacedBySafeLawInTheSameTick) {
  for (const double bad : {kNan, kInf, -kInf}) {
    for (int field = 0; field < 5; ++field) {
      if (field == 1 && std::isnan(bad)) continue;  // NaN as a position target means none
      Bench bench;
      bench.velocity[0] = 1.0;
      std::array<JointArray*, 5>{&bench.torque, &bench.position_target, &bench.velocity_target, &bench.kp,
                                 &bench.kd}[static_cast<std::size_t>(field)]
          ->front() = bad;
      const Verdict verdict = bench.check();
      EXPECT_EQ(verdict.fault, Fault::law_not_finite) << field;
      EXPECT_TRUE(verdict.use_safe_law);
      EXPECT_EQ(verdict.flags & flag::kNotFinite, flag::kNotFinite);
      EXPECT_TRUE(std::isfinite(bench.out.torque_nm[0]));
      bench.velocity[0] = 0.98;
      EXPECT_LE(std::abs(bench.felt_nm()), kSlewPerTick + kRounding);
    }
  }
}

TEST(Guard, OneBadJointBringsTheSafeLawToAll) {
  Bench bench(robot_with(3));
  bench.torque = {0.05, kNan, 0.05};
  bench.velocity = {1, 1, -1};
  const Verdict verdict = bench.check();
  EXPECT_TRUE(verdict.use_safe_law);
  for (int i = 0; i < 3; ++i) EXPECT_TRUE(std::isfinite(bench.out.torque_nm[static_cast<std::size_t>(i)]));
}

TEST(Guard, JointsBeyondTheRobotsAreNobodysBusiness) {
  Bench bench(robot_with(2));
  bench.torque[2] = kNan;
  bench.position[5] = kNan;
  bench.status[9] = wire::joint_status::kFault;
  EXPECT_EQ(bench.check().fault, Fault::none);
}

TEST(Guard, TorqueThatPushesOutwardsFadesBeforeThePositionLimit) {
  Bench bench;  // limits -2 and 3, zone 0.1
  bench.torque[0] = 0.5;
  bench.position[0] = 2.95;
  EXPECT_EQ(bench.settle().flags, flag::kPositionClamped);
  EXPECT_NEAR(bench.out.torque_nm[0], 0.25, 1e-9);
  bench.position[0] = 3.0;
  bench.settle();
  EXPECT_EQ(bench.out.torque_nm[0], 0.0);
  bench.position[0] = 3.1;
  bench.settle();
  EXPECT_EQ(bench.out.torque_nm[0], 0.0);
  bench.torque[0] = -0.5;  // inwards is always free
  EXPECT_EQ(bench.settle().flags, 0U);
  EXPECT_NEAR(bench.out.torque_nm[0], -0.5, kRounding);
  bench.position[0] = -2.0;
  bench.settle();
  EXPECT_EQ(bench.out.torque_nm[0], 0.0);
}

TEST(Guard, FarBeyondAPositionLimitIsAFault) {
  Bench bench;
  bench.position[0] = 3.19;
  EXPECT_EQ(bench.check().fault, Fault::none);
  bench.position[0] = 3.21;
  const Verdict verdict = bench.check();
  EXPECT_EQ(verdict.fault, Fault::position_limit);
  EXPECT_TRUE(verdict.use_safe_law);
  bench.position[0] = -2.21;
  EXPECT_EQ(bench.check().fault, Fault::position_limit);
}

TEST(Guard, AboveTheVelocityLimitOnlyBrakingIsFreeAndFarAboveIsAFault) {
  Bench bench;  // limit 10, fault at 12.5
  bench.torque[0] = 0.4;
  bench.velocity[0] = 11.25;
  EXPECT_EQ(bench.settle().flags, flag::kVelocityClamped);
  EXPECT_NEAR(bench.out.torque_nm[0], 0.2, 1e-9);
  bench.torque[0] = -0.4;
  EXPECT_EQ(bench.settle().flags, 0U);
  EXPECT_NEAR(bench.out.torque_nm[0], -0.4, kRounding);
  bench.velocity[0] = -12.6;
  EXPECT_EQ(bench.check().fault, Fault::velocity_limit);
}

// In a slow loop with a light joint the stiffness fades over several ticks: there it is without a target.
TEST(Guard, ALawThatDropsItsPositionTargetGetsAFiniteTorqueWithinTheSlewBound) {
  robot::RobotConfig robot = robot_with(1);
  robot.rate_hz = 250;
  robot.joints[0].inertia_max_kg_m2 = robot.joints[0].inertia_min_kg_m2 = 0.001;
  robot.joints[0].safe_kd_nm_s_rad = 0.01;  // with more, the envelope takes the stiffness away in one tick
  const double slew_nm = robot.joints[0].torque_slew_nm_s / robot.rate_hz;
  Bench bench(robot);
  bench.position_target[0] = 0.002;
  bench.kp[0] = 50;
  bench.settle(500);
  EXPECT_NEAR(bench.felt_nm(), 0.1, 1e-3);
  bench.position_target[0] = kNan;
  int stiff_ticks = 0;
  for (int i = 0; i < 10; ++i) {
    const double before_nm = bench.felt_nm();
    bench.check();
    ASSERT_TRUE(std::isfinite(bench.out.torque_nm[0])) << "tick " << i;
    ASSERT_LE(std::abs(bench.felt_nm() - before_nm), slew_nm + 1e-9) << "tick " << i;
    stiff_ticks += bench.out.kp_nm_rad[0] > 0 ? 1 : 0;
  }
  EXPECT_GE(stiff_ticks, 2) << "otherwise this shows nothing";
  EXPECT_NEAR(bench.felt_nm(), 0, 1e-9);
}

TEST(Guard, AStaleSampleIsFlaggedAndTooManyInARowAreAFault) {
  Bench bench;
  bench.stale_ticks = 19;
  Verdict verdict = bench.check();
  EXPECT_EQ(verdict.flags, flag::kSampleStale);
  EXPECT_EQ(verdict.fault, Fault::none);
  bench.torque[0] = 0.5;
  bench.settle(5);
  bench.stale_ticks = 20;
  bench.velocity[0] = 3;  // too old to act upon
  verdict = bench.settle(10);
  EXPECT_EQ(verdict.fault, Fault::sample_stale);
  EXPECT_TRUE(verdict.use_safe_law);
  EXPECT_EQ(bench.out.torque_nm[0], 0.0);
}

TEST(Guard, AMeasurementThatIsNoNumberIsNeverActedUpon) {
  for (const double bad : {kNan, kInf, 1.0e300, -1.0e7}) {
    Bench bench;
    bench.position[0] = bad;
    Verdict verdict = bench.check();
    EXPECT_EQ(verdict.fault, Fault::sample_stale);
    EXPECT_EQ(bench.out.torque_nm[0], 0.0);
    bench.position[0] = 0;
    bench.velocity[0] = bad;
    verdict = bench.check();
    EXPECT_EQ(verdict.fault, Fault::sample_stale);
    EXPECT_EQ(bench.out.torque_nm[0], 0.0);
  }
}

TEST(Guard, ASilentBrainIsFlaggedAndStopsTheRobotOnlyWhereConfigured) {
  for (const bool stop : {false, true}) {
    robot::RobotConfig robot = robot_with(1);
    robot.brain.stale_after_s = 0.1;
    robot.brain.on_stale = stop ? robot::StaleAction::safe_stop : robot::StaleAction::hold;
    Bench bench(robot);
    bench.brain_age_ns = 100'000'000;
    EXPECT_EQ(bench.check().flags, 0U);
    for (const std::int64_t age : {std::int64_t{100'000'001}, std::int64_t{-1}}) {
      bench.brain_age_ns = age;
      const Verdict verdict = bench.check();
      EXPECT_EQ(verdict.flags, flag::kBrainStale);
      EXPECT_EQ(verdict.fault, stop ? Fault::brain_stale : Fault::none);
      EXPECT_EQ(verdict.use_safe_law, stop);
    }
  }
}

TEST(Guard, DriveTroubleIsAFaultAndTheWorstIsReported) {
  Bench bench(robot_with(2));
  bench.status[1] = wire::joint_status::kFresh;
  EXPECT_EQ(bench.check().fault, Fault::none);
  bench.status[1] = wire::joint_status::kLost;
  EXPECT_EQ(bench.check().fault, Fault::drive_lost);
  bench.status[1] |= wire::joint_status::kWatchdog;
  EXPECT_EQ(bench.check().fault, Fault::drive_watchdog);
  bench.status[0] = wire::joint_status::kFault | (33U << 8);
  bench.torque[0] = kNan;
  EXPECT_EQ(bench.check().fault, Fault::drive_fault);
}

TEST(Guard, DisarmedAndEmergencyStoppedMeanOffAtOnce) {
  for (const Mode mode : {Mode::disarmed, Mode::estop, static_cast<Mode>(77)}) {
    Bench bench;
    bench.torque[0] = 0.9;
    bench.settle();
    bench.mode = mode;
    bench.kp[0] = 10;
    const Verdict verdict = bench.check();
    EXPECT_EQ(verdict.fault, Fault::none);
    EXPECT_FALSE(verdict.use_safe_law);
    EXPECT_EQ(bench.out.torque_nm[0], 0.0);
    EXPECT_EQ(bench.out.kp_nm_rad[0], 0.0);
    EXPECT_EQ(bench.out.max_torque_nm[0], 0.0);
    bench.mode = Mode::active;  // and arming again starts from 0
    bench.check();
    EXPECT_NEAR(bench.felt_nm(), kSlewPerTick, kRounding);
  }
}

TEST(Guard, SafeStopRunsTheSafeLawWhateverTheLawSays) {
  Bench bench;
  bench.mode = Mode::safe_stop;
  bench.torque[0] = kNan;
  bench.velocity[0] = 0.2;
  const Verdict verdict = bench.settle();
  EXPECT_TRUE(verdict.use_safe_law);
  EXPECT_EQ(verdict.fault, Fault::none);
  EXPECT_LT(bench.out.torque_nm[0], 0.0);
}

TEST(Guard, TheDrivesOwnPdIsBoundedWithTheFeedForward) {
  Bench bench;
  bench.position_target[0] = 9;  // beyond the limit 3
  bench.velocity_target[0] = -99;
  bench.kp[0] = 1e9;
  bench.kd[0] = -4;
  bench.check();
  EXPECT_EQ(bench.out.position_rad[0], 3.0);
  EXPECT_EQ(bench.out.velocity_rad_s[0], -10.0);
  EXPECT_LE(bench.out.kp_nm_rad[0], 50.0);
  EXPECT_EQ(bench.out.kd_nm_s_rad[0], 0.0);
  EXPECT_NEAR(bench.felt_nm(), kSlewPerTick, kRounding);
}

// One joint of inertia 0.01 with gravity, driven at 1 kHz by what the drive makes of the guard's output.
double speed_after_blindness_rad_s(bool drive_damps) {
  robot::RobotConfig robot = robot_with(1);
  if (!drive_damps) robot.joints[0].safe_kd_nm_s_rad = 1e-12;
  Bench bench(robot);
  double speed_rad_s = 0;
  for (int i = 0; i < 300; ++i) {
    bench.status[0] = wire::joint_status::kLost;
    bench.check();
    const double felt_nm = bench.out.torque_nm[0] - bench.out.kd_nm_s_rad[0] * speed_rad_s;
    speed_rad_s += (0.5 + std::clamp(felt_nm, -bench.out.max_torque_nm[0], bench.out.max_torque_nm[0])) / 0.01 * 1e-3;
  }
  return speed_rad_s;
}

TEST(Guard, AJointWithoutASampleIsDampedByItsDriveInsteadOfFalling) {
  EXPECT_NEAR(speed_after_blindness_rad_s(true), 1.0, 0.01);  // sinks at gravity / damping
  EXPECT_NEAR(speed_after_blindness_rad_s(false), 15.0, 0.1);
}

TEST(Guard, OnlyTheJointWithoutASampleIsLeftToItsDrive) {
  Bench bench(robot_with(2));
  bench.status[1] = wire::joint_status::kLost;
  bench.velocity = {0.2, 0.2};
  bench.settle(100);
  EXPECT_EQ(bench.out.kd_nm_s_rad[0], 0.0);
  EXPECT_LT(bench.out.torque_nm[0], 0.0);
  EXPECT_EQ(bench.out.kd_nm_s_rad[1], 0.5);
  EXPECT_EQ(bench.out.torque_nm[1], 0.0);
  EXPECT_TRUE(std::isnan(bench.out.position_rad[1]));
}

TEST(Guard, DampingGrowsAfterTheTorqueHasFadedAndNeitherStepsBeyondTheSlewBound) {
  Bench bench;
  bench.torque[0] = 0.45;
  bench.settle();
  bench.status[0] = wire::joint_status::kLost;
  double torque_nm = 0.45, kd = 0;
  for (int i = 0; i < 200; ++i) {
    bench.check();
    const double fastest_rad_s = 12.5;  // any faster is a fault
    const double step = std::abs(bench.out.torque_nm[0] - torque_nm) + (bench.out.kd_nm_s_rad[0] - kd) * fastest_rad_s;
    ASSERT_LE(step, kSlewPerTick + 1e-9) << i;
    ASSERT_GE(bench.out.kd_nm_s_rad[0], kd);
    torque_nm = bench.out.torque_nm[0];
    kd = bench.out.kd_nm_s_rad[0];
  }
  EXPECT_EQ(torque_nm, 0.0);
  EXPECT_EQ(kd, 0.5);
}

TEST(Guard, AJointThatIsHeardAgainStartsFromWhatItsDriveDamps) {
  Bench bench;
  bench.status[0] = wire::joint_status::kLost;
  bench.settle(100);
  bench.status[0] = 0;
  bench.velocity[0] = 1.2;
  bench.torque[0] = 0.9;
  bench.check();
  EXPECT_NEAR(bench.felt_nm(), -0.5 * 1.2 + kSlewPerTick, kRounding);
  EXPECT_EQ(bench.out.kd_nm_s_rad[0], 0.0);
}

TEST(Guard, WhatNeverLeftIsNotWhereTheNextStepStarts) {
  Bench bench;
  bench.torque[0] = 0.9;
  bench.check();
  for (int i = 0; i < 5; ++i) {  // the bus is late: the drive still applies the first step
    bench.check(i == 0);
    EXPECT_NEAR(bench.felt_nm(), 2 * kSlewPerTick, kRounding);
  }
  bench.check();
  EXPECT_NEAR(bench.felt_nm(), 3 * kSlewPerTick, kRounding);
}

TEST(Guard, NothingIsAllocatedInTheTick) {
  Bench bench(robot_with(kMaxJoints));
  const NoAllocScope scope;
  for (int i = 0; i < 100; ++i) {
    bench.torque[3] = i % 10 == 0 ? kNan : 0.1;
    bench.check();
  }
  bench.guard.reset_output();
}

TEST(Guard, AJointWithoutAnAnswerBrakesAsFarAheadAsItsSampleIsOld) {
  robot::RobotConfig robot = robot_with(1);
  robot.joints[0].inertia_min_kg_m2 = robot.joints[0].inertia_max_kg_m2 = 0.02;
  robot.joints[0].load_max_nm = 0.1;
  const auto allowed_nm = [&](std::uint32_t status, int ticks) {
    Bench bench(robot);
    bench.position[0] = 2.05;
    bench.velocity[0] = 8;
    bench.torque[0] = 1;
    bench.settle();
    bench.status[0] = status;
    bench.settle(ticks);
    return bench.felt_nm();
  };
  EXPECT_EQ(allowed_nm(wire::joint_status::kFresh, 1), allowed_nm(wire::joint_status::kFresh, 4));
  EXPECT_LT(allowed_nm(0, 1), allowed_nm(wire::joint_status::kFresh, 1));
  EXPECT_LT(allowed_nm(0, 4), allowed_nm(0, 1));
}

}  // namespace
}  // namespace lithe::guard
