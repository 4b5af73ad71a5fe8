// SPDX-License-Identifier: Apache-2.0
// Probation around a pause of the machine, and of what runs again before it was confirmed.
#include <cmath>

#include "spine/loop/test/laws_rig.hpp"

namespace lithe::loop {
namespace {

// The machine takes the tick away for 0.1 s: the setpoint is 0.4 rad further when the law is back, through no fault of
// its.
TEST_F(LawsTest, APauseOfTheMachineIsNotBlamedOnTheLaw) {
  arm_with(kPd);
  terms_.probation_ticks = 1000, terms_.probation_error_ratio = 3;
  stage(kPd);
  publish(2.0, 500);
  ticks(100);
  ASSERT_EQ(slot_.active()->law_id, 2u);
  tick(true, 99);
  const double error_rad = std::abs(record_.setpoint_position_rad[0] - record_.position_rad[0]);
  EXPECT_GT(error_rad, 3 * step::Probation::kLeastErrorRad) << "more than the law would be allowed";
  ticks(300);
  EXPECT_EQ(slot_.active()->law_id, 2u) << "and it has caught up by then";
  EXPECT_TRUE(events(EventKind::law_rolled_back).empty());
}

// As after `arm`: the joint is far from a setpoint that went on without it. The law before did no better.
TEST_F(LawsTest, ALawCommittedAfterAPauseIsNotBlamedForTheErrorThatItFound) {
  arm_with(kLazy);
  ticks(1500);
  terms_.probation_ticks = 1000, terms_.probation_error_ratio = 3;
  publish(0.4, 200);
  tick(true, 20);
  ticks(250);
  stage(kLazy);
  tick();
  ASSERT_EQ(slot_.active()->law_id, 2u);
  ticks(1000);
  EXPECT_GT(std::abs(record_.setpoint_position_rad[0] - record_.position_rad[0]), 0.3);
  EXPECT_EQ(slot_.active()->law_id, 2u);
}

TEST_F(LawsTest, ButForTheErrorThatItMadeItIs) {
  arm_with(kPd);
  ticks(1500);
  terms_.probation_ticks = 1000, terms_.probation_error_ratio = 3;
  publish(0.4, 200);
  tick(true, 20);
  stage(kLazy);
  tick();
  ASSERT_EQ(slot_.active()->law_id, 2u);
  ticks(400);
  EXPECT_EQ(slot_.active()->law_id, 1u);
}

TEST_F(LawsTest, ABadLawIsFoundAfterAPause) {
  arm_with(kPd);
  publish(0.4);
  ticks(1500);
  terms_.probation_ticks = 1000, terms_.probation_error_ratio = 3;
  stage(kPush);
  tick();
  ASSERT_EQ(slot_.active()->law_id, 2u);
  tick(true, 20);
  for (int i = 0; i < 1000 && slot_.active()->law_id == 2; ++i) tick();
  EXPECT_EQ(slot_.active()->law_id, 1u);
  EXPECT_FALSE(events(EventKind::law_rolled_back).empty());
}

// ---- what is not confirmed stays on probation

TEST_F(LawsTest, AnUnprovenLawThatRunsAgainIsOnProbationAgain) {
  arm_with(kPd);
  terms_.probation_ticks = 400, terms_.probation_error_ratio = 3;
  stage(kPd);
  ticks(600);
  ASSERT_NE(record_.flags & flag::kUnproven, 0u);
  stage(kPush);
  for (int i = 0; i < 1000 && (i < 2 || slot_.active()->law_id == 3); ++i) tick();
  ASSERT_EQ(slot_.active()->law_id, 2u);
  tick();
  EXPECT_NE(record_.flags & flag::kOnProbation, 0u);
  stage(kPd);
  ticks(5);
  ASSERT_EQ(send(CommandKind::rollback), CommandResult::done);
  ticks(2);
  EXPECT_EQ(slot_.active()->law_id, 2u);
  EXPECT_NE(record_.flags & flag::kOnProbation, 0u) << "asked for, too";
}

class UnprovenInARow : public LawsTest {
 protected:
  UnprovenInARow() {
    arm_with(kPd);
    ticks(1500);
    terms_.probation_ticks = 1000, terms_.probation_error_ratio = 3;
    Beside<1>::off_rad = 0.7 * kAllowedRad, Beside<2>::off_rad = 0;
    stage(kFirst);
    ticks(600);
    EXPECT_EQ(slot_.active()->law_id, 2u);
  }
  // The law that runs after so many ticks.
  std::uint32_t law_after(int most) {
    ticks(most);
    return slot_.active()->law_id;
  }
};

TEST_F(UnprovenInARow, TheyAreAllComparedWithTheTimeBeforeTheFirst) {
  Beside<2>::off_rad = 2 * 0.7 * kAllowedRad;
  stage(kSecond);
  EXPECT_EQ(law_after(300), 2u) << "three times as far off as the first would be nine times as far as before";
  EXPECT_EQ(mode(), Mode::active);
}

TEST_F(UnprovenInARow, ButAfterOneWhoseErrorIsNotJudgedWithItsTime) {
  terms_.probation_error_ratio = 0;
  Beside<2>::off_rad = 2 * kAllowedRad;
  stage(kSecond);
  ASSERT_EQ(law_after(600), 3u);
  terms_.probation_error_ratio = 3;
  stage(kPd);
  EXPECT_EQ(law_after(600), 4u) << "it starts as far off as that one left it";
}

TEST_F(UnprovenInARow, TheFirstKeepsItsMeasureThroughTheSecond) {
  stage(kPush);
  for (int i = 0; i < 1000 && (i < 2 || slot_.active()->law_id == 3); ++i) tick();
  ASSERT_EQ(law_after(600), 2u) << "it may bring the joint back first";
  Beside<1>::off_rad = 1.5 * kAllowedRad;
  EXPECT_EQ(law_after(300), 1u) << "the errors of the second allow it nothing";
}

TEST_F(UnprovenInARow, AfterOneThatWasConfirmedItIsComparedWithThat) {
  Beside<2>::off_rad = 0.8 * kAllowedRad;
  stage(kSecond);
  ticks(2);
  publish(2.0, 3000);
  live(1500);
  ASSERT_FALSE(events(EventKind::law_confirmed).empty());
  live(2500);
  ASSERT_EQ(slot_.active()->law_id, 3u);
  ASSERT_EQ(send(CommandKind::rollback), CommandResult::done);
  Beside<1>::off_rad = 1.5 * kAllowedRad;
  EXPECT_EQ(law_after(600), 2u) << "no worse than the law that was confirmed";
}

// There is no law to go back to: the robot stops, and the same law runs after the reset.
TEST_F(LawsTest, AnUnprovenLawThatStoppedTheRobotIsOnProbationAfterTheReset) {
  arm_with(kPd);
  terms_.probation_ticks = 1000, terms_.probation_error_ratio = 3;
  for (std::uint32_t i = 0; i < law::kHistory + 1; ++i) {
    stage(kPushesLater);
    ticks(3);
  }
  wire::Command back;
  back.kind = static_cast<std::uint32_t>(CommandKind::rollback);
  back.count = law::kHistory;
  ASSERT_EQ(send(back), CommandResult::done);
  ticks(3);
  ASSERT_EQ(slot_.active()->law_id, 2u);
  ASSERT_NE(record_.flags & flag::kOnProbation, 0u);
  for (int time = 0; time < 3; ++time) {
    PushesLater::now = true;
    double error_rad = 0;
    for (int i = 0; i < 1000 && mode() == Mode::active; ++i) {
      tick();
      error_rad = std::max(error_rad, std::abs(record_.setpoint_position_rad[0] - record_.position_rad[0]));
    }
    PushesLater::now = false;
    ASSERT_EQ(mode(), Mode::safe_stop) << time;
    ASSERT_EQ(static_cast<wire::Fault>(record_.fault), wire::Fault::law_faulted) << time;
    EXPECT_LT(error_rad, 4 * step::Probation::kLeastErrorRad) << "no more than the first time";
    ASSERT_EQ(send_off(CommandKind::reset), CommandResult::done);
    ticks(500);
    ASSERT_EQ(arm_all_the_same(), CommandResult::done);
    ticks(400);
    ASSERT_EQ(slot_.active()->law_id, 2u);
    EXPECT_NE(record_.flags & flag::kOnProbation, 0u);
  }
}

TEST_F(LawsTest, ValuesOnProbationLeaveWithTheirLaw) {
  arm_with(kTuned);
  ASSERT_EQ(slot_.active()->params[0].value, 0);
  ASSERT_EQ(set(0, 0.1), CommandResult::done);
  ASSERT_NE((tick(), record_.flags & flag::kParamsOnProbation), 0u);
  stage(kPd);
  ticks(5);
  ASSERT_EQ(slot_.active()->law_id, 2u);
  ASSERT_EQ(send(CommandKind::rollback), CommandResult::done);
  ticks(2);
  ASSERT_EQ(slot_.active()->law_id, 1u);
  EXPECT_EQ(slot_.active()->params[0].value, 0);
}

TEST_F(LawsTest, ValuesSetLateInALawsProbationAreJudgedAsLong) {
  arm_with(kPd);
  terms_.probation_ticks = 400, terms_.probation_error_ratio = 100;
  stage(kTuned);
  publish(2.0, 3000);
  live(390);
  ASSERT_EQ(slot_.active()->law_id, 2u);
  ASSERT_EQ(set(0, 0.01), CommandResult::done);
  live(300);
  EXPECT_TRUE(events(EventKind::law_confirmed).empty());
  live(200);
  EXPECT_EQ(events(EventKind::law_confirmed).size(), 1u);
}

}  // namespace
}  // namespace lithe::loop
