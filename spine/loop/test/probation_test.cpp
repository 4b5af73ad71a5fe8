// SPDX-License-Identifier: Apache-2.0
// A new law's first second: blend, probation, and what becomes of it.
#include <cstdio>
#include <string>

#include "spine/core/time.hpp"
#include "spine/loop/test/laws_rig.hpp"

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
  double largest_rad = step::Probation::kLeastErrorRad;  // of the second before, roughly
  for (int i = 0; i < 3000; ++i) {
    brain_memory_->header.heartbeat_ns = now_ns_;
    tick();
    const double error_rad = std::abs(record_.setpoint_position_rad[0] - record_.position_rad[0]);
    if (i > 2000) largest_rad = std::max(largest_rad, error_rad);
  }
  terms_.probation_ticks = 1000, terms_.probation_error_ratio = 3;
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
  const auto told = events(EventKind::law_rolled_back);
  ASSERT_EQ(told.size(), 1u);
  double error_rad = 0, allowed_rad = 0;
  EXPECT_EQ(std::sscanf(told[0].text.data(), "tracking_lost: joint %*[^,], error %lf rad, allowed %lf", &error_rad,
                        &allowed_rad),
            2)
      << told[0].text.data();
  EXPECT_GE(error_rad, allowed_rad) << "rounded";
  EXPECT_NEAR(allowed_rad, 3 * largest_rad, 0.5 * largest_rad);
  ASSERT_NE(breach_tick, 0u);
  EXPECT_LE(record_.tick - breach_tick, 2u);
  tick();
  EXPECT_EQ(record_.law_id, 1u);
}

// Lifts the arm with a constant torque beside what its weight needs.
struct Lifts {
  struct Params {};
  struct State {};
  static void step(const Tick& t, const Params&, State&, Effort& u) {
    u.torque_nm[0] = 0.165 * std::sin(t.position_rad[0]) + 0.3;
  }
};
const RawClock kRawClock = RawClock::calibrate(kNsPerMs);
struct Slow {  // takes 50 us
  struct Params {};
  struct State {};
  static void step(const Tick& t, const Params&, State&, Effort& u) {
    const std::int64_t until_ns = kRawClock.now_ns() + 50'000;
    while (kRawClock.now_ns() < until_ns) {
    }
    u.torque_nm[0] = -0.2 * t.velocity_rad_s[0];
  }
};
struct SlowAndTuned {  // 50 us
  struct Params {
    Param kd_nm_s_rad{0.1, 0, 1};
  };
  struct State {};
  static void step(const Tick& t, const Params& p, State&, Effort& u) {
    const std::int64_t end_ns = kRawClock.now_ns() + 50'000;
    while (kRawClock.now_ns() < end_ns) {
    }
    u.torque_nm[0] = 4 * (t.setpoint_position_rad[0] - t.position_rad[0]) - p.kd_nm_s_rad * t.velocity_rad_s[0];
  }
};
constexpr LitheLaw kLifts = describe<Lifts>("lifts");
constexpr LitheLaw kSlow = describe<Slow>("slow");
constexpr LitheLaw kSlowAndTuned = describe<SlowAndTuned>("slow_and_tuned");

class GuardBusyTest : public LawsTest {
 protected:
  // The reason for which this law was replaced: the share of clamped ticks in it is taken out and checked.
  std::string why_not(const LitheLaw& law, int within_ticks) {
    arm_with(kPd);
    ticks(300);
    terms_.probation_ticks = 60'000;
    stage(law);
    tick();
    for (int i = 0; i < within_ticks && slot_.active()->law_id == 2; ++i) tick();
    EXPECT_EQ(slot_.active()->law_id, 1u);
    const auto told = events(EventKind::law_rolled_back);
    if (told.size() != 1) return "";
    EXPECT_EQ(next_fault()->kind, static_cast<std::uint32_t>(LawFaultKind::guard_busy));
    std::string text = told[0].text.data();
    double share = 0;
    EXPECT_EQ(std::sscanf(text.c_str(), "guard_busy: joint shoulder clamped in %lf", &share), 1) << text;
    EXPECT_GE(share, 80) << text;
    EXPECT_LT(share, 81) << text;
    return text.substr(std::min(text.find(" % of"), text.size()));
  }
};

TEST_F(GuardBusyTest, ATorqueThatIsTooLargeIsNamedWithItsLimit) {
  EXPECT_EQ(why_not(kPush, 2000), " % of ticks, allowed 80: wants -1000.000 N m of 0.600");
}

TEST_F(GuardBusyTest, APositionAtItsLimitIsNamedWithIt) {
  const std::string why = why_not(kLifts, 20'000);
  double at_rad = 0;
  ASSERT_EQ(std::sscanf(why.c_str(), " %% of ticks, allowed 80: at %lf rad of 3.000", &at_rad), 1) << why;
  EXPECT_NEAR(at_rad, 3, 0.11) << why;
}

TEST_F(GuardBusyTest, ASpeedAboveItsLimitIsNamedWithIt) {
  robot_.joints[0].velocity_max_rad_s = 3;
  use_cell(nullptr);
  const std::string why = why_not(kLifts, 4000);
  double speed_rad_s = 0;
  ASSERT_EQ(std::sscanf(why.c_str(), " %% of ticks, allowed 80: at %lf rad%*[/]s of 3.0", &speed_rad_s), 1) << why;
  EXPECT_NE(why.find(" rad/s of 3.0"), std::string::npos) << why;
  EXPECT_GT(speed_rad_s, 1.5) << why;
}

TEST_F(GuardBusyTest, WhatTheGuardClampedBeforeTheLawIsNotBlamedOnIt) {
  arm_with(kPush);
  ticks(1000);
  terms_.probation_ticks = 60'000;
  stage(kPush);
  ticks(1000);
  EXPECT_EQ(slot_.active()->law_id, 2u);
  EXPECT_TRUE(events(EventKind::law_rolled_back).empty());
}

TEST_F(LawsTest, ALawThatIsTooSlowThreeTimesInARowIsReplacedAndTheTimesAreTold) {
  arm_with(kPd);
  ticks(100);
  terms_.probation_ticks = 60'000;
  terms_.budget_ns = 10'000;
  stage(kSlow);
  ticks(1 + static_cast<int>(step::Probation::kMostLong));
  EXPECT_EQ(slot_.active()->law_id, 1u);
  EXPECT_EQ(next_fault()->kind, static_cast<std::uint32_t>(LawFaultKind::overran));
  const auto told = events(EventKind::law_rolled_back);
  ASSERT_EQ(told.size(), 1u);
  double took_us = 0, times = 0;
  EXPECT_EQ(std::sscanf(told[0].text.data(), "overran: a step took %lf us, allowed 10.0, %lf times in a row", &took_us,
                        &times),
            2)
      << told[0].text.data();
  EXPECT_GE(took_us, 50);
  EXPECT_EQ(times, step::Probation::kMostLong);
}

TEST_F(LawsTest, ValuesAreJudgedByTheTimeBudgetOfTheirOwnLaw) {
  arm_with(kSlowAndTuned);
  terms_.budget_ns = 10'000;
  terms_.probation_ticks = 1000;
  stage(kPd);
  ticks(3);
  ASSERT_EQ(send(CommandKind::rollback), CommandResult::done);
  ticks(3);
  ASSERT_EQ(slot_.active()->law_id, 1u);
  ASSERT_EQ(set(0, 0.2), CommandResult::done);
  ticks(50);
  EXPECT_EQ(slot_.active()->params[0].value, 0.2) << "not by that of the law that has left";
}

TEST_F(LawsTest, ALawThatGivesNoNumberIsReplacedAndTheJointNamed) {
  arm_with(kPd);
  stage(kNotFinite);
  ticks(2);
  ASSERT_EQ(record_.law_id, 1u);
  for (const EventKind kind : {EventKind::law_faulted, EventKind::law_rolled_back}) {
    ASSERT_EQ(events(kind).size(), 1u);
    const std::string text = events(kind)[0].text.data();
    double at_rad = 0, setpoint_rad = 0;
    ASSERT_EQ(
        std::sscanf(text.c_str(), "not_finite: joint shoulder, torque_nm; at %lf rad, %*f rad/s, %*f N m, setpoint %lf",
                    &at_rad, &setpoint_rad),
        2)
        << text;
    EXPECT_NEAR(at_rad, record_.position_rad[0], 6e-4) << "rounded";
    EXPECT_NEAR(setpoint_rad, record_.setpoint_position_rad[0], 6e-4);
  }
}

// At rest, nothing is proven; then it moves.
TEST_F(LawsTest, AGoodLawIsConfirmedOnceTheRobotHasMovedForLongEnough) {
  arm_with(kPd);
  ticks(300);
  terms_.probation_ticks = 50, terms_.probation_error_ratio = 3;
  stage(kPd);
  ticks(200);
  EXPECT_TRUE(events(EventKind::law_confirmed).empty());
  ASSERT_EQ(events(EventKind::law_unproven).size(), 1u);
  EXPECT_EQ(events(EventKind::law_unproven)[0].value, 0) << "the law";
  EXPECT_EQ(record_.flags & (flag::kOnProbation | flag::kUnproven), flag::kOnProbation | flag::kUnproven);
  publish(0.2);
  for (int i = 0; i < 200 && (record_.flags & flag::kOnProbation) != 0; ++i) tick();
  EXPECT_EQ(events(EventKind::law_confirmed).size(), 1u);
  EXPECT_EQ(record_.law_id, 2u);
}

TEST_F(LawsTest, ALawThatIsStillUnprovenIsRolledBackByWhatItDoesInMotion) {
  arm_with(kPd);
  ticks(300);
  terms_.probation_ticks = 400, terms_.probation_error_ratio = 3;
  stage(kLazy);
  ticks(500);
  EXPECT_EQ(slot_.active()->law_id, 2u);
  EXPECT_EQ(events(EventKind::law_unproven).size(), 1u);
  publish(1.0);
  live(1000);
  EXPECT_EQ(slot_.active()->law_id, 1u);
  EXPECT_TRUE(events(EventKind::law_confirmed).empty());
}

TEST_F(LawsTest, ALawThatChattersOnProbationIsReplacedAndTheJointNamed) {
  arm_with(kPd);
  publish(0.2);
  ticks(300);
  terms_.probation_ticks = 2000;
  stage(kChatters);
  ticks(100);
  EXPECT_EQ(slot_.active()->law_id, 1u);
  const auto told = events(EventKind::law_rolled_back);
  ASSERT_EQ(told.size(), 1u);
  double found_hz = 0, jump_nm = 0, allowed_nm = 0;
  ASSERT_EQ(std::sscanf(told[0].text.data(), "chattering: joint shoulder, %lf Hz, swings of %lf, allowed %lf N m",
                        &found_hz, &jump_nm, &allowed_nm),
            3)
      << told[0].text.data();
  EXPECT_GE(found_hz, law::Tremor::kChatterHz) << told[0].text.data();
  EXPECT_GE(jump_nm, allowed_nm) << told[0].text.data();
  EXPECT_NEAR(allowed_nm, 0.2 * 0.6, 1e-9) << "of torque_max_nm";
}

TEST_F(LawsTest, ALawThatSwingsTheJointOnProbationIsReplaced) {
  arm_with(kPd);
  publish(0.1);
  ticks(300);
  terms_.probation_ticks = 60'000;
  stage(kSwings);
  ticks(2);
  publish(0.3, 200);
  for (int i = 0; i < 5000 && slot_.active()->law_id == 2; ++i) live(1);
  EXPECT_EQ(slot_.active()->law_id, 1u);
  const auto told = events(EventKind::law_rolled_back);
  ASSERT_EQ(told.size(), 1u);
  double found_hz = 0, swing_rad_s = 0, allowed_rad_s = 0;
  ASSERT_EQ(std::sscanf(told[0].text.data(), "oscillating: joint shoulder, %lf Hz, swings of %lf, allowed %lf rad/s",
                        &found_hz, &swing_rad_s, &allowed_rad_s),
            3)
      << told[0].text.data();
  EXPECT_GE(swing_rad_s, allowed_rad_s) << told[0].text.data();
  EXPECT_GE(allowed_rad_s, 0.1 * 30) << "of velocity_max_rad_s: " << told[0].text.data();
}

TEST_F(LawsTest, ParametersThatSwingTheJointAreRevertedAndTheLawStays) {
  arm_with(kTuned);
  publish(0.1);
  ticks(300);
  EXPECT_EQ(set(0, 0.1), CommandResult::done);
  ticks(10);
  EXPECT_NE(record_.flags & flag::kParamsOnProbation, 0u);
  EXPECT_EQ(set(1, -0.012), CommandResult::done);  // drives instead of damping
  publish(0.3, 200);
  for (int i = 0; i < 5000 && events(EventKind::params_reverted).empty(); ++i) live(1);
  ASSERT_EQ(events(EventKind::params_reverted).size(), 1u);
  EXPECT_EQ(slot_.active()->law_id, 1u);
  EXPECT_EQ(mode(), Mode::active);
  EXPECT_EQ(slot_.active()->params[0].value, 0.0) << "of both changes, for the first had not proven itself";
  EXPECT_EQ(slot_.active()->params[1].value, 0.1);
  tick();
  EXPECT_EQ(record_.flags & flag::kParamsOnProbation, 0u);
}

TEST_F(LawsTest, ParametersThatBreakTheLawAreRevertedInTheSameTick) {
  arm_with(kTuned);
  ticks(100);
  EXPECT_EQ(set(0, 1.0), CommandResult::done);  // a division by 1 - bias
  EXPECT_EQ(mode(), Mode::active);
  EXPECT_EQ(slot_.active()->params[0].value, 0.0);
  EXPECT_EQ(events(EventKind::params_reverted).size(), 1u);
  EXPECT_TRUE(events(EventKind::law_rolled_back).empty());
  const auto fault = next_fault();
  ASSERT_TRUE(fault);
  EXPECT_EQ(fault->to_law_id, 1u) << "itself, as it was";
}

TEST_F(LawsTest, GoodParametersAreConfirmedInMotionAndCanBeRevertedByHand) {
  arm_with(kTuned);
  ticks(300);
  EXPECT_EQ(set(0, 0.01), CommandResult::done);
  const int probation = static_cast<int>(robot_.swap.probation_s * robot_.rate_hz);
  live(probation + 10);
  EXPECT_TRUE(events(EventKind::params_confirmed).empty());
  ASSERT_EQ(events(EventKind::law_unproven).size(), 1u);
  EXPECT_EQ(events(EventKind::law_unproven)[0].value, 1) << "its parameters";
  for (int i = 0; i < 5 * probation && events(EventKind::params_confirmed).empty(); ++i) {
    if (i % 200 == 0) publish(i % 400 == 0 ? 0.3 : -0.3);
    live(1);
  }
  EXPECT_EQ(events(EventKind::params_confirmed).size(), 1u);
  EXPECT_EQ(send(CommandKind::revert_params), CommandResult::done);
  EXPECT_EQ(slot_.active()->params[0].value, 0.0);
  EXPECT_EQ(send(CommandKind::revert_params), CommandResult::done);
  EXPECT_EQ(slot_.active()->params[0].value, 0.01) << "a second time: that change again";
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
  ASSERT_EQ(events(EventKind::law_rolled_back).size(), 1u);
  EXPECT_STREQ(events(EventKind::law_rolled_back)[0].text.data(),
               "guard_stopped: joint shoulder, velocity_limit: 100.0 rad/s, allowed 37.5");
  ASSERT_EQ(events(EventKind::safe_stop).size(), 1u);
  EXPECT_STREQ(events(EventKind::safe_stop)[0].text.data(),
               "velocity_limit at joint shoulder: 100.0 rad/s, allowed 37.5");
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
