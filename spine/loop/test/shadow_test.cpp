// SPDX-License-Identifier: Apache-2.0
// A candidate beside the active law, in the tick.
#include "spine/loop/test/laws_rig.hpp"

namespace lithe::loop {
namespace {

TEST_F(LawsTest, AShadowThatAgreesIsPromotedWithTheStateItHas) {
  arm_with(kPd);
  terms_.shadow_ticks = 20;
  terms_.shadow_tolerance_nm = 0.31;
  stage(kLifted);
  tick();
  EXPECT_EQ(slot_.active()->law_id, 1u);
  for (int i = 0; i < 19; ++i) {
    tick();
    ASSERT_EQ(slot_.active()->law_id, 1u) << "tick " << i;
    ASSERT_NE(record_.flags & flag::kShadowing, 0u);
  }
  tick();
  ASSERT_EQ(slot_.active()->law_id, 2u);
  EXPECT_EQ(reinterpret_cast<const Lifted::State*>(slot_.active()->state.data())->calls, 20.0);
  const auto ended = events(EventKind::shadow_ended);
  ASSERT_EQ(ended.size(), 1u);
  EXPECT_EQ(ended[0].code, 1u);
  EXPECT_NEAR(ended[0].value, 0.3, 1e-9);
  EXPECT_EQ(shadow_report().ticks, 20u);
  EXPECT_NEAR(shadow_report().rms_nm[0], 0.3, 1e-9);
  EXPECT_EQ(events(EventKind::law_committed).size(), 2u);
}

TEST_F(LawsTest, AShadowThatDisagreesOrFailsNeverMovesAnything) {
  for (const LitheLaw* law : {&kLifted, &kNotFinite}) {
    arm_with(kPd);
    const std::uint32_t active_id = slot_.active()->law_id;
    terms_.shadow_ticks = 100;
    terms_.shadow_tolerance_nm = 0.1;
    law::Resident& candidate = stage(*law);
    ticks(3);
    EXPECT_EQ(slot_.active()->law_id, active_id);
    EXPECT_EQ(events(EventKind::shadow_ended).back().code, 0u);
    EXPECT_EQ(events(EventKind::shadow_ended).back().request_id, candidate.request_id);
    EXPECT_EQ(slot_.collect_retired(), &candidate);
    EXPECT_EQ(record_.flags & flag::kLawFaulted, 0u) << "nothing it wanted went anywhere";
    terms_ = {};
  }
}

TEST_F(LawsTest, AShadowThatIsOnlyMeasuredIsComparedToItsEndWhateverItWants) {
  arm_with(kPd);
  terms_.shadow_ticks = 20;
  terms_.shadow_tolerance_nm = 0.1;  // it differs by 0.3
  terms_.shadow_only = true;
  law::Resident& candidate = stage(kLifted);
  ticks(40);
  EXPECT_EQ(slot_.active()->law_id, 1u);
  EXPECT_EQ(shadow_report().ticks, 20u);
  EXPECT_NEAR(shadow_report().most_nm[0], 0.3, 1e-9);
  const auto ended = events(EventKind::shadow_ended);
  ASSERT_EQ(ended.size(), 1u);
  EXPECT_EQ(ended[0].code, 2u);
  EXPECT_EQ(slot_.collect_retired(), &candidate);
  EXPECT_EQ(events(EventKind::law_committed).size(), 1u);
}

TEST_F(LawsTest, AShadowEndsWhenNothingRunsBesideIt) {
  arm_with(kPd);
  terms_.shadow_ticks = 100;
  stage(kPd);
  ticks(5);
  EXPECT_EQ(send(CommandKind::disarm), CommandResult::done);
  tick();
  EXPECT_EQ(events(EventKind::shadow_ended).at(0).code, 0u);
  EXPECT_EQ(slot_.active()->law_id, 1u);
}

TEST_F(LawsTest, AShadowHasATimeOfItsOwnThatGoesOnAfterItsPromotion) {
  arm_with(kPd);
  ticks(500);
  terms_.shadow_ticks = 50;
  stage(kClock);
  ticks(52);
  ASSERT_EQ(record_.law_id, 2u);
  EXPECT_NEAR(record_.command_torque_nm[0] * 10, 0.050, 1e-9);
}

TEST_F(LawsTest, AShadowWhoseTorqueNoNumberHoldsIsRefused) {
  arm_with(kPd);
  terms_.shadow_ticks = 20;
  terms_.shadow_tolerance_nm = 0.1;
  stage(kHuge);
  ticks(30);
  ASSERT_EQ(events(EventKind::shadow_ended).size(), 1u);
  EXPECT_EQ(events(EventKind::shadow_ended)[0].code, 0u);
}

}  // namespace
}  // namespace lithe::loop
