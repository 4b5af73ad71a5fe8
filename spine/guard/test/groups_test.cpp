// SPDX-License-Identifier: Apache-2.0
// The effect of a joint's fault on its group; it has no effect on the other groups.
#include <gtest/gtest.h>

#include <cmath>

#include "spine/guard/test/guard_rig.hpp"

namespace lithe::guard {
namespace {

namespace flag = wire::telemetry_flag;
using wire::Fault;
using wire::Mode;

// Joints 0 and 1 are a leg, 2 and 3 an arm.
robot::RobotConfig with_groups(robot::OtherGroups others = robot::OtherGroups::go_on) {
  robot::RobotConfig robot = robot_with(4);
  robot.guard.other_groups = others;
  robot.joints[0].group = robot.joints[1].group = "leg";
  robot.joints[2].group = robot.joints[3].group = "arm";
  return robot;
}

TEST(GuardGroups, AFaultStopsItsGroupAndTheOthersGoOn) {
  Bench bench(with_groups());
  bench.torque.fill(0.5);
  bench.settle();
  bench.status[1] = wire::joint_status::kLost;
  const Verdict verdict = bench.check();
  EXPECT_EQ(verdict.fault, Fault::drive_lost);
  EXPECT_FALSE(verdict.use_safe_law) << "not for the whole robot";
  EXPECT_NE(verdict.flags & flag::kGroupStopped, 0U);
  EXPECT_EQ(bench.out.rung[0], Rung::safe_law);
  EXPECT_EQ(bench.out.rung[1], Rung::safe_law);
  EXPECT_EQ(bench.out.rung[2], Rung::law);
  ASSERT_EQ(bench.guard.groups().size(), 2U);
  EXPECT_TRUE(bench.guard.groups()[0].news);
  EXPECT_EQ(bench.guard.groups()[0].joint, 1);
  bench.settle();
  EXPECT_FALSE(bench.guard.groups()[0].news);
  EXPECT_EQ(bench.felt_nm(0), 0);
  EXPECT_NEAR(bench.felt_nm(2), 0.5, 1e-9);
  EXPECT_NEAR(bench.felt_nm(3), 0.5, 1e-9);
}

TEST(GuardGroups, ItIsToldOnceAndLatchedUntilAPersonResets) {
  Bench bench(with_groups());
  bench.status[2] = wire::joint_status::kFault;
  EXPECT_EQ(bench.check().fault, Fault::drive_fault);
  EXPECT_EQ(bench.check().fault, Fault::none) << "the loop has this fault already";
  bench.status[2] = 0;
  bench.settle();
  EXPECT_EQ(bench.out.rung[3], Rung::safe_law);
  EXPECT_EQ(bench.guard.joint_fault(2), Fault::drive_fault);
  EXPECT_EQ(bench.guard.joint_fault(3), Fault::none) << "this joint has no fault";
  bench.guard.forget_faults();
  bench.check();
  EXPECT_EQ(bench.out.rung[3], Rung::law);
  EXPECT_EQ(bench.guard.joint_fault(2), Fault::none);
}

TEST(GuardGroups, TheLastGroupThatStopsIsTheRobot) {
  Bench bench(with_groups());
  bench.status[0] = wire::joint_status::kLost;
  EXPECT_FALSE(bench.check().use_safe_law);
  bench.velocity[2] = 13;  // 12.5 is too fast
  const Verdict verdict = bench.check();
  EXPECT_TRUE(verdict.use_safe_law);
  EXPECT_EQ(verdict.fault, Fault::velocity_limit) << "the new fault, not the older one of another joint";
}

TEST(GuardGroups, WhereTheOthersShallStopTheyStop) {
  Bench bench(with_groups(robot::OtherGroups::stop));
  bench.status[0] = wire::joint_status::kLost;
  EXPECT_TRUE(bench.check().use_safe_law);
  EXPECT_EQ(bench.out.rung[3], Rung::safe_law);
}

TEST(GuardGroups, WithoutGroupsEveryFaultIsEverybodys) {
  robot::RobotConfig robot = robot_with(2);
  robot.guard.other_groups = robot::OtherGroups::go_on;
  Bench bench(robot);
  bench.status[0] = wire::joint_status::kLost;
  EXPECT_TRUE(bench.check().use_safe_law);
  EXPECT_EQ(bench.out.rung[1], Rung::safe_law);
}

TEST(GuardGroups, WhatIsNobodysAloneStopsAll) {
  for (int what = 0; what < 3; ++what) {
    robot::RobotConfig robot = with_groups();
    robot.brain.on_stale = robot::StaleAction::safe_stop;
    Bench bench(robot);
    if (what == 0) bench.stale_ticks = 100;
    if (what == 1) bench.brain_age_ns = 10'000'000'000;
    if (what == 2) bench.torque[3] = kNan;
    EXPECT_TRUE(bench.check().use_safe_law) << what;
  }
}

TEST(GuardGroups, WhatALawWantsOfAStoppedJointIsNobodysBusiness) {
  Bench bench(with_groups());
  bench.status[0] = wire::joint_status::kLost;
  bench.torque[1] = kNan;
  Verdict verdict = bench.check();
  EXPECT_FALSE(verdict.use_safe_law);
  EXPECT_EQ(verdict.flags & flag::kNotFinite, 0U);
  bench.torque[1] = 1000;
  bench.position[1] = 2.99;
  verdict = bench.settle();
  EXPECT_EQ(verdict.law_flags, 0U);
  bench.torque[2] = kNan;
  EXPECT_EQ(bench.check().fault, Fault::law_not_finite) << "and not the older fault of another joint";
}

TEST(GuardGroups, AnEstopKeepsTheRungsAndArmingForgetsThem) {
  robot::RobotConfig robot = with_groups();
  robot.guard.brake_after_s = 0.01;
  robot.guard.off_after_s = 0.02;
  Bench bench(robot);
  bench.status[0] = wire::joint_status::kFault;
  bench.settle(100);
  ASSERT_EQ(bench.out.rung[0], Rung::off);
  bench.mode = wire::Mode::estop;
  bench.check();
  EXPECT_EQ(bench.out.rung[0], Rung::off);
  EXPECT_EQ(bench.out.rung[3], Rung::law);
  bench.status[0] = 0;
  bench.guard.forget_faults();
  bench.guard.reset_output();
  bench.check();
  EXPECT_EQ(bench.out.rung[0], Rung::law);
}

TEST(GuardGroups, EachGroupGoesDownTheLadderInItsOwnTime) {
  robot::RobotConfig robot = with_groups();
  robot.guard.brake_after_s = 0.05;
  robot.guard.off_after_s = 0.08;
  Bench bench(robot);
  bench.torque.fill(0.5);
  bench.status[0] = wire::joint_status::kFault;
  bench.velocity[1] = 1;
  bench.velocity[3] = 2;  // a joint of the arm
  EXPECT_EQ(bench.rung_after(200, 1), Rung::safe_law) << "its group still moves";
  bench.velocity[1] = 0;
  EXPECT_EQ(bench.rung_after(50, 1), Rung::safe_law);
  EXPECT_EQ(bench.rung_after(1, 1), Rung::brake);
  EXPECT_EQ(bench.out.torque_nm[1], 0);
  EXPECT_EQ(bench.rung_after(30, 1), Rung::off);
  EXPECT_EQ(bench.out.rung[3], Rung::law);
  EXPECT_NEAR(bench.felt_nm(3), 0.5, 1e-9);
}

TEST(GuardGroups, NothingJumpsWhenAGroupStopsOrGoesDown) {
  robot::RobotConfig robot = with_groups();
  robot.guard.safe_end = robot::SafeEnd::hold;
  Bench bench(robot);
  JointArray before{};
  for (int tick = 0; tick < 400; ++tick) {
    for (std::size_t j = 0; j < 4; ++j) bench.torque[j] = tick / 25 % 2 == 0 ? 0.9 : -0.9;
    if (tick == 200) bench.status[0] = wire::joint_status::kFault;
    bench.velocity[1] = 3;
    bench.check();
    for (std::size_t j = 0; j < 4; ++j) {
      ASSERT_LE(std::abs(bench.felt_nm(j) - before[j]), kSlewPerTick + 1e-9) << "joint " << j << " at " << tick;
      before[j] = bench.felt_nm(j);
    }
  }
  EXPECT_EQ(bench.out.rung[1], Rung::safe_law);
}

TEST(GuardGroups, AJointThatMustBeHomedAndNoLongerIsStopsItsGroup) {
  robot::RobotConfig robot = with_groups();
  robot.joints[3].must_be_homed = true;
  Bench bench(robot);
  bench.status.fill(wire::joint_status::kNotHomed);
  EXPECT_EQ(bench.check().fault, Fault::drive_not_homed);
  EXPECT_EQ(bench.out.rung[0], Rung::law) << "it need not be homed";
  EXPECT_EQ(bench.out.rung[2], Rung::safe_law);
}

TEST(GuardGroups, ADriveOfWhichThereAreTwoIsDampedBlindly) {
  Bench bench(with_groups());
  bench.status[0] = wire::joint_status::kConflict | wire::joint_status::kLost;
  EXPECT_EQ(bench.check().fault, Fault::drive_conflict);
  bench.settle(100);
  EXPECT_EQ(bench.out.torque_nm[0], 0);
  EXPECT_EQ(bench.out.kd_nm_s_rad[0], 0.5);
}

}  // namespace
}  // namespace lithe::guard
