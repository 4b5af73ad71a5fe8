// SPDX-License-Identifier: Apache-2.0
// A new law's first second: blend, probation, and what becomes of it.
#include "spine/loop/laws_bench.hpp"

namespace lithe::loop {
namespace {

TEST_F(LawsTest, TheFirstOutputOfABlendedLawIsTheLastOfTheOneBefore) {
  arm_with(kPd);
  publish(0.4);
  ticks(400);
  terms_.blend_ticks = 50;
  stage(kLifted);
  tick();
  const double before_nm = record_.command_torque_nm[0];
  tick();
  EXPECT_NE(record_.flags & flag::kBlending, 0u);
  EXPECT_NEAR(record_.command_torque_nm[0], before_nm, 1e-12);
  double largest_nm = 0, last_nm = record_.command_torque_nm[0];
  for (int i = 0; i < 60; ++i) {
    tick();
    largest_nm = std::max(largest_nm, std::abs(record_.command_torque_nm[0] - last_nm));
    last_nm = record_.command_torque_nm[0];
  }
  EXPECT_LT(largest_nm, 0.3 / 10) << "a cold swap steps by about 0.12: the slew bound";
  EXPECT_EQ(record_.flags & flag::kBlending, 0u);
}

TEST_F(LawsTest, ALawThatLosesTrackOnProbationIsReplacedWithinTwoTicks) {
  arm_with(kPd);
  publish(0.4);
  double largest_rad = Probation::kLeastErrorRad;  // of the second before, roughly
  for (int i = 0; i < 3000; ++i) {
    brain_memory_->header.heartbeat_ns = now_ns_;
    tick();
    const double error_rad = std::abs(record_.setpoint_position_rad[0] - record_.position_rad[0]);
    if (i > 2000) largest_rad = std::max(largest_rad, error_rad);
  }
  terms_.probation_ticks = 1000;
  terms_.probation_error_ratio = 3;
  stage(kPush);
  tick();
  ASSERT_EQ(slot_.active()->law_id, 2u);
  std::uint64_t breach_tick = 0;
  for (int i = 0; i < 2000 && slot_.active()->law_id == 2; ++i) {
    tick();
    const double error_rad = std::abs(record_.setpoint_position_rad[0] - record_.position_rad[0]);
    if (breach_tick == 0 && error_rad > 3 * largest_rad) breach_tick = record_.tick;
  }
  ASSERT_EQ(slot_.active()->law_id, 1u);
  EXPECT_EQ(next_fault()->kind, static_cast<std::uint32_t>(LawFaultKind::tracking_lost));
  EXPECT_EQ(mode(), Mode::active);
  ASSERT_NE(breach_tick, 0u);
  EXPECT_LE(record_.tick - breach_tick, 2u);
  tick();
  EXPECT_EQ(record_.law_id, 1u);
}

TEST_F(LawsTest, AGoodLawIsConfirmed) {
  arm_with(kPd);
  terms_.probation_ticks = 50;
  terms_.probation_error_ratio = 3;
  stage(kPd);
  ticks(50);
  EXPECT_TRUE(events(EventKind::law_confirmed).empty());
  EXPECT_NE(record_.flags & flag::kOnProbation, 0u);
  tick();
  EXPECT_EQ(events(EventKind::law_confirmed).size(), 1u);
  tick();
  EXPECT_EQ(record_.flags & flag::kOnProbation, 0u);
}

TEST_F(LawsTest, ALawOnProbationThatTheGuardHasToStopDoesNotRunAfterTheReset) {
  arm_with(kPd);
  terms_.probation_ticks = 60'000;
  stage(kPush);
  ticks(2);
  tick(false);
  sent_ = handover_.command();
  actuators_->cycle(sent_, handover_.sample(), now_ns_);
  handover_.sample().velocity_rad_s[0] = 100;  // of 30 that are allowed
  handover_.finish();
  tick();
  ASSERT_EQ(mode(), Mode::safe_stop);
  EXPECT_EQ(slot_.active()->law_id, 1u);
  const auto fault = next_fault();
  ASSERT_TRUE(fault);
  EXPECT_EQ(fault->kind, static_cast<std::uint32_t>(LawFaultKind::guard_stopped));
  EXPECT_EQ(fault->to_law_id, 1u);
}

TEST_F(LawsTest, WhatIsLeftOfABlendEndsWithTheMotion) {
  arm_with(kPd);
  ticks(100);
  terms_.blend_ticks = 5000;
  stage(kLifted);
  ticks(10);
  ASSERT_NE(record_.flags & flag::kBlending, 0u);
  EXPECT_EQ(send(CommandKind::disarm), CommandResult::done);
  ticks(10);
  EXPECT_EQ(send(CommandKind::arm), CommandResult::done);
  ticks(10);
  EXPECT_EQ(record_.flags & flag::kBlending, 0u);
}

}  // namespace
}  // namespace lithe::loop
