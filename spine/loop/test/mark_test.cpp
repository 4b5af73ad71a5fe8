// SPDX-License-Identifier: Apache-2.0
// A law that stopped the robot: it is not armed again unless somebody says so.
#include <cmath>

#include "spine/loop/test/laws_rig.hpp"

namespace lithe::loop {
namespace {

class MarkTest : public LawsTest {
 protected:
  // The drive measures this speed once: 30 rad/s are allowed.
  void measure(double velocity_rad_s) {
    tick(false);
    sent_ = handover_.command();
    actuators_->cycle(sent_, handover_.sample(), now_ns_);
    handover_.sample().velocity_rad_s[0] = velocity_rad_s;
    handover_.finish();
    tick();
    ASSERT_EQ(mode(), Mode::safe_stop);
  }
  // Confirmed, and drives the joint out.
  void run_away() {
    arm_with(kPd);
    stage(kPush);
    ticks(60);
    ASSERT_LT(record_.velocity_rad_s[0], -1.0) << "it drives";
    measure(-100);
    ASSERT_EQ(slot_.active()->law_id, 2u) << "it was not on probation";
    serve();
    ASSERT_EQ(send_off(CommandKind::reset), CommandResult::done);
    ticks(20);
  }
};

TEST_F(MarkTest, ALawThatDroveAJointOutIsNotArmedAgain) {
  run_away();
  const auto told = events(EventKind::law_marked);
  ASSERT_EQ(told.size(), 1u);
  EXPECT_EQ(told[0].code, 2u);
  EXPECT_STREQ(told[0].text.data(), "guard_stopped: joint shoulder, velocity_limit: -100.0 rad/s, allowed 37.5");
  EXPECT_NE(record_.flags & flag::kLawMarked, 0u);
  EXPECT_EQ(send(CommandKind::arm), CommandResult::refused_marked);
  EXPECT_EQ(send(CommandKind::rollback), CommandResult::done);
  EXPECT_EQ(record_.flags & flag::kLawMarked, 0u) << "the law before it did nothing";
  EXPECT_EQ(send(CommandKind::arm), CommandResult::done);
}

TEST_F(MarkTest, WhoSaysSoArmsItAllTheSame) {
  run_away();
  EXPECT_EQ(arm_all_the_same(), CommandResult::done);
  EXPECT_EQ(record_.flags & flag::kLawMarked, 0u);
}

TEST_F(MarkTest, AJointThatIsThrownOutMarksNoLaw) {
  arm_with(kPd);
  ticks(500);
  measure(100);
  serve();
  EXPECT_TRUE(events(EventKind::law_marked).empty());
  ASSERT_EQ(send_off(CommandKind::reset), CommandResult::done);
  ticks(20);
  EXPECT_EQ(send(CommandKind::arm), CommandResult::done);
}

TEST_F(MarkTest, AFaultWithoutALawToGoBackToMarks) {
  arm_with(kLateNan);
  ticks(20);
  ASSERT_EQ(mode(), Mode::safe_stop);
  ASSERT_EQ(send_off(CommandKind::reset), CommandResult::done);
  ticks(20);
  EXPECT_EQ(send(CommandKind::arm), CommandResult::refused_marked);
}

TEST_F(MarkTest, ARescueLawIsNotRolledBackToTheMarkedOne) {
  run_away();
  terms_.probation_ticks = 1000, terms_.probation_error_ratio = 3;
  stage(kLateNan);
  ticks(3);
  ASSERT_EQ(send(CommandKind::arm), CommandResult::done);
  ticks(30);
  EXPECT_EQ(slot_.active()->law_id, 1u);
  EXPECT_EQ(mode(), Mode::active);
}

}  // namespace
}  // namespace lithe::loop
