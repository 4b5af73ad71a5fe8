// SPDX-License-Identifier: Apache-2.0
// What happens when answers are missing, late, doubled, foreign or nonsense.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

#include "spine/hal/test/two_joints_rig.hpp"

namespace lithe::hal {
namespace {

TEST_F(TwoJoints, AMissingAnswerIsCountedAndTheLastValuesStay) {
  cycle(Trick::none);
  const double position = state_.position_rad[1];
  EXPECT_NEAR(position, 0.2, 4e-4);
  cycle(Trick::drop);
  EXPECT_TRUE(fresh(0));
  EXPECT_FALSE(fresh(1));
  EXPECT_FALSE(lost(1));
  EXPECT_EQ(state_.position_rad[1], position);
  EXPECT_EQ(actuators_.counters().missed, 1U);
}

TEST_F(TwoJoints, ThreeMissesInARowMakeAJointLostAndOneAnswerFindsIt) {
  cycle(Trick::none);
  cycle(Trick::drop, 2);
  EXPECT_FALSE(lost(1));
  cycle(Trick::drop);
  EXPECT_TRUE(lost(1));
  EXPECT_FALSE(lost(0));
  cycle(Trick::drop, 100);
  EXPECT_TRUE(lost(1));
  EXPECT_EQ(actuators_.counters().missed, 103U);
  cycle(Trick::none);
  EXPECT_FALSE(lost(1));
  EXPECT_TRUE(fresh(1));
}

TEST_F(TwoJoints, TheLastValuesStayAlsoWhenTheCallerAlternatesBuffers) {
  cycle(Trick::none);
  state_ = ActuatorState{};
  cycle(Trick::drop);
  EXPECT_NEAR(state_.position_rad[1], 0.2, 4e-4);
}

TEST_F(TwoJoints, ALateAnswerIsNeverTakenForTheNextOne) {
  cycle(Trick::none);
  cycle(Trick::hold_back);
  EXPECT_FALSE(fresh(1));
  const double still = state_.position_rad[1];
  cables_[1]->drive().servo().plant().place(0.7);
  cycle(Trick::none);  // the old answer comes right before the new one
  EXPECT_EQ(actuators_.counters().late, 1U);
  EXPECT_EQ(actuators_.counters().duplicate, 0U);
  EXPECT_NE(state_.position_rad[1], still);
  EXPECT_NEAR(state_.position_rad[1], 0.7, 4e-4);
}

// However long it was stuck somewhere.
TEST_F(TwoJoints, NoReplayedAnswerIsTakenForANewOne) {
  cycle(Trick::none);
  Frame old;
  for (int age = 1; age <= 125; ++age) {
    cables_[1]->keep = &old;
    cycle(Trick::none);
    cables_[1]->keep = nullptr;
    cycle(Trick::none, age - 1);
    cables_[1]->replay = &old;  // before the answer of this exchange, which does not come
    const std::uint64_t late = actuators_.counters().late;
    cycle(Trick::drop);
    cables_[1]->replay = nullptr;
    ASSERT_FALSE(fresh(1)) << age;
    ASSERT_EQ(actuators_.counters().late, late + 1) << age;
  }
}

TEST_F(TwoJoints, WhatArrivesBetweenTwoExchangesIsLate) {
  cycle(Trick::none);
  Frame request;
  request.id = 0x8000 | 2;
  bus_->send(request);
  cycle(Trick::none);
  EXPECT_EQ(actuators_.counters().late, 1U);
  EXPECT_TRUE(fresh(1));
}

TEST_F(TwoJoints, ADoubledAnswerCountsOnce) {
  cycle(Trick::twice, 10);
  EXPECT_TRUE(fresh(1));
  EXPECT_EQ(actuators_.counters().duplicate, 10U);
  EXPECT_EQ(actuators_.counters().missed, 0U);
}

TEST_F(TwoJoints, AForeignAnswerIsStrayAndTheJointMissed) {
  cycle(Trick::stray);
  EXPECT_EQ(actuators_.counters().stray, 1U);
  EXPECT_EQ(actuators_.counters().missed, 1U);
}

TEST_F(TwoJoints, AGarbledAnswerIsMalformedAndTheJointMissed) {
  cycle(Trick::garble);
  EXPECT_EQ(actuators_.counters().malformed, 1U);
  EXPECT_EQ(actuators_.counters().missed, 1U);
  EXPECT_EQ(state_.position_rad[1], 0.0);
  cycle(Trick::garble, 2);
  EXPECT_NE(state_.status[1] & wire::joint_status::kGarbled, 0U) << "lost, but not silent";
  cycle(Trick::none);
  EXPECT_EQ(state_.status[1] & wire::joint_status::kGarbled, 0U);
}

TEST_F(TwoJoints, ABabblingNodeKeepsNobodyBusyForEver) {
  cycle(Trick::none);
  const std::uint64_t before = bus_->statistics().received;
  cycle(Trick::babble);
  EXPECT_LE(bus_->statistics().received - before, 256U + 4 * 2 + 16) << "what it may bring in one exchange";
  cycle(Trick::babble, 20);
  EXPECT_TRUE(fresh(0));
  EXPECT_TRUE(fresh(1));
  EXPECT_GT(actuators_.counters().late, 1000U);
}

TEST_F(TwoJoints, AnUnsoundCommandDampsItsJointAndIsCounted) {
  command_.act(DriveAction::torque);
  command_.torque_nm[1] = std::nan("");
  cycle(Trick::none, 20);
  EXPECT_EQ(actuators_.counters().unsound, 20U);
  EXPECT_EQ((state_.status[0] >> 16) & 0xff, 10U);
  EXPECT_EQ((state_.status[1] >> 16) & 0xff, 12U);
}

// Also where the drive's own limit, which grows from nothing, would have hidden it.
TEST(MoteusLimit, ALimitThatIsNotFiniteIsNoSoundCommand) {
  moteus::DriverParams params;
  params.torque_step_nm = 0.1;
  moteus::MoteusDrive drive(params);
  LoopBus bus;
  JointCommand command;
  command.action = DriveAction::torque;
  command.max_torque_nm = std::numeric_limits<double>::infinity();
  EXPECT_FALSE(drive.command(command, {}, bus));
  command.max_torque_nm = 1;
  EXPECT_TRUE(drive.command(command, {}, bus));
}

TEST_F(TwoJoints, AnyMixOfFaultsLeavesTheStateFiniteAndTheCountsConsistent) {
  std::mt19937 random(9);
  command_.act(DriveAction::torque);
  std::uint64_t expected_missed = 0;
  for (int i = 0; i < 5000; ++i) {
    cycle(static_cast<Trick>(random() % 9));
    expected_missed += (fresh(0) ? 0U : 1U) + (fresh(1) ? 0U : 1U);
    for (int joint = 0; joint < 2; ++joint) {
      ASSERT_TRUE(std::isfinite(state_.position_rad[joint]));
      ASSERT_LT(std::abs(state_.position_rad[joint]), 10.0);
    }
  }
  EXPECT_EQ(actuators_.counters().missed, expected_missed);
}

}  // namespace
}  // namespace lithe::hal
