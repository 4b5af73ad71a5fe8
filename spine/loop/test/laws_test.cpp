// SPDX-License-Identifier: Apache-2.0
// What the tick does with laws that fail, with every real part around it.
#include <algorithm>
#include <atomic>
#include <cstdio>
#include <thread>
#include <utility>

#include "spine/contain/fault_barrier.hpp"
#include "spine/contain/memory/protected_memory.hpp"
#include "spine/contain/test/contain_rig.hpp"
#include "spine/contain/watchdog.hpp"
#include "spine/loop/test/laws_rig.hpp"

namespace lithe::loop {
namespace {

TEST_F(LawsTest, ALawThatIsNotFiniteIsReplacedByTheOneBeforeInTheSameTick) {
  arm_with(kPd);
  publish(0.5);
  stage(kNotFinite);
  tick();  // commits at its end
  ASSERT_EQ(slot_.active()->law_id, 2u);
  tick();  // the first and last tick of the bad law
  EXPECT_EQ(mode(), Mode::active);
  EXPECT_EQ(record_.law_id, 1u) << "its output left, and nothing of the bad law's";
  EXPECT_NE(record_.flags & flag::kLawFaulted, 0u);
  EXPECT_NE(record_.flags & flag::kRolledBack, 0u);
  const auto fault = next_fault();
  ASSERT_TRUE(fault);
  EXPECT_EQ(fault->kind, static_cast<std::uint32_t>(LawFaultKind::not_finite));
  EXPECT_EQ(fault->law_id, 2u);
  EXPECT_EQ(fault->to_law_id, 1u);
  EXPECT_EQ(fault->tick, record_.tick);
}

TEST_F(LawsTest, AWayBackThatWasCountedFromALawThatLeftMeanwhileIsRefused) {
  arm_with(kPd);
  stage(kPd);
  ticks(2);
  stage(kNotFinite);
  ticks(2);
  ASSERT_EQ(slot_.active()->law_id, 2u) << "law 3 failed in its first tick";
  wire::Command command;
  command.kind = static_cast<std::uint32_t>(CommandKind::rollback);
  command.count = 1;
  command.law_id = 3;
  EXPECT_EQ(send(command), CommandResult::refused_law);
  EXPECT_EQ(slot_.active()->law_id, 2u);
  command.law_id = 2;
  EXPECT_EQ(send(command), CommandResult::done);
  EXPECT_EQ(slot_.active()->law_id, 1u);
}

TEST_F(LawsTest, WithoutALawBeforeItTheSafeLawTakesOverInTheSameTick) {
  arm_with(kLateNan);
  while (mode() == Mode::active && record_.tick < 100) tick();
  EXPECT_EQ(mode(), Mode::safe_stop);
  EXPECT_EQ(static_cast<wire::Fault>(record_.fault), wire::Fault::law_not_finite);
  EXPECT_NE(record_.flags & flag::kNotFinite, 0u);
  ASSERT_EQ(events(EventKind::safe_stop).size(), 1u);
  EXPECT_EQ(std::string(events(EventKind::safe_stop)[0].text.data()).substr(0, 26), "not_finite: joint shoulder");
  for (int i = 0; i < 500; ++i) {
    tick();
    ASSERT_TRUE(std::isfinite(sent_.torque_nm[0]));
    ASSERT_LE(std::abs(sent_.torque_nm[0]), 0.6);
  }
  EXPECT_EQ(send(CommandKind::arm), CommandResult::refused_fault);
}

TEST_F(LawsTest, APoisonedStateDoesNotLockTheNextLawOut) {
  arm_with(kPoisoner);
  ticks(10);
  stage(kIntegrate);
  ticks(20);
  EXPECT_EQ(slot_.active()->law_id, 2u) << "it starts from its default, and runs";
  EXPECT_FALSE(next_fault());
  const auto told = events(EventKind::state_not_carried);
  ASSERT_EQ(told.size(), 1u);
  EXPECT_EQ(told[0].code, 2u);
  EXPECT_EQ(told[0].value, 1);
  EXPECT_STREQ(told[0].text.data(), "integral_nm: no finite number; starts from its default");
  const auto kind_at = [](const wire::Event& each) { return std::pair(static_cast<EventKind>(each.kind), each.code); };
  const auto position = [&](EventKind kind) { return std::ranges::find(all_, std::pair(kind, 2U), kind_at); };
  EXPECT_LT(position(EventKind::state_not_carried), position(EventKind::law_committed)) << "its answer needs it";
  slot_.before(1)->state = {};
  EXPECT_EQ(send(CommandKind::rollback), CommandResult::done);
  EXPECT_EQ(events(EventKind::state_not_carried).size(), 1u) << "nothing is wrong on this way back";
}

TEST_F(LawsTest, TwoBadLawsInARowEndInTheSafeLaw) {
  arm_with(kPd);
  stage(kLateNan);
  ticks(2);
  slot_.active()->state = {};
  stage(kNotFinite);
  tick();
  reinterpret_cast<LateNan::State*>(slot_.before(1)->state.data())->steps = 100;
  tick();
  EXPECT_EQ(mode(), Mode::safe_stop);
  const auto first = next_fault(), second = next_fault();
  ASSERT_TRUE(first && second);
  EXPECT_EQ(first->law_id, 3u);
  EXPECT_EQ(first->to_law_id, 2u);
  EXPECT_EQ(second->law_id, 2u);
  EXPECT_EQ(second->to_law_id, 0u) << "the safe law";
  EXPECT_EQ(slot_.active()->law_id, 1u) << "what runs after a reset";
}

TEST_F(LawsTest, ASensorThatIsNotANumberIsNotTheLawsFault) {
  arm_with(kPd);
  stage(kIntegrate);
  ticks(2);
  for (int i = 0; i < 3; ++i) {
    now_ns_ += kNsPerMs;
    spine_->tick(now_ns_, now_ns_ + 100, 0);
    sent_ = handover_.command();
    actuators_->cycle(sent_, handover_.sample(), now_ns_);
    handover_.sample().position_rad[0] = std::numeric_limits<double>::quiet_NaN();
    handover_.finish();
  }
  reader_.latest(record_);
  EXPECT_FALSE(next_fault()) << "the law would be replaced, and the next one, for nothing";
  EXPECT_EQ(mode(), Mode::safe_stop);
  EXPECT_EQ(static_cast<wire::Fault>(record_.fault), wire::Fault::sample_stale);
  ASSERT_EQ(send(CommandKind::reset), CommandResult::done);
  ASSERT_EQ(send(CommandKind::arm), CommandResult::done);
  ticks(20);
  EXPECT_EQ(mode(), Mode::active) << "the sensor is well again, and the law does not remember that it was not";
  EXPECT_EQ(record_.law_id, 2u);
}

TEST_F(LawsTest, WhatALawDoesToItsInputsGoesNoFurther) {
  arm_with(kPd);
  publish(0.5);
  ticks(50);
  const double setpoint_rad = record_.setpoint_position_rad[0];
  law::Resident& bad = stage(kScribble);
  const Param gain = bad.params[0];
  ticks(2);
  EXPECT_EQ(record_.law_id, 1u);
  EXPECT_EQ(mode(), Mode::active);
  EXPECT_GE(record_.setpoint_position_rad[0], setpoint_rad);
  EXPECT_EQ(bad.params[0].value, gain.value);
  EXPECT_TRUE(std::isfinite(record_.command_torque_nm[0]));
}

TEST_F(LawsTest, RollbackGoesBackByAsManyLawsAsAsked) {
  arm_with(kPd);
  for (int i = 0; i < 3; ++i) {
    stage(kLifted);
    ticks(2);
  }
  wire::Command command;
  command.kind = static_cast<std::uint32_t>(CommandKind::rollback);
  command.count = 9;
  EXPECT_EQ(send(command), CommandResult::refused_law);
  EXPECT_EQ(record_.law_id, 4u) << "refused: nothing changed";
  command.count = 3;
  EXPECT_EQ(send(command), CommandResult::done);
  EXPECT_EQ(record_.law_id, 1u);
}

TEST_F(LawsTest, ParamsRevertToTheSetBeforeTheLastChange) {
  arm_with(kPd);
  wire::Command command;
  command.kind = static_cast<std::uint32_t>(CommandKind::set_params);
  command.count = 1;
  command.value[0] = 8.0;
  EXPECT_EQ(send(command), CommandResult::done);
  EXPECT_EQ(send(CommandKind::revert_params), CommandResult::done);
  EXPECT_EQ(slot_.active()->params[0].value, 4.0);
  EXPECT_EQ(send(CommandKind::revert_params), CommandResult::done);
  EXPECT_EQ(slot_.active()->params[0].value, 8.0);
}

TEST_F(LawsTest, ALawThatCrashesIsReplacedInTheSameTick) {
  if (contain::kReportsFaults) GTEST_SKIP() << "the sanitizer wants SIGSEGV for itself";
  contain::FaultBarrier barrier = contain::open_barrier();
  use_cell(&barrier);
  arm_with(kPd);
  for (int round = 0; round < 50; ++round) {
    stage(kCrash);
    ticks(2);
    ASSERT_EQ(record_.law_id, 1u) << "round " << round;
    ASSERT_EQ(mode(), Mode::active);
    const auto fault = next_fault();
    ASSERT_TRUE(fault);
    ASSERT_EQ(fault->kind, static_cast<std::uint32_t>(LawFaultKind::bad_access));
    ASSERT_EQ(fault->address, 8u);
    ASSERT_NE(fault->pc, 0u);
    ASSERT_EQ(fault->pc_offset, 0u) << "it lies in no slot";
  }
}

struct Endless {
  struct Params {};
  struct State {};
  static void step(const Tick& t, const Params&, State&, Effort&) {
    const volatile bool goes_on = t.dt_s > 0;
    while (goes_on) {
    }
  }
};
constexpr LitheLaw kEndless = describe<Endless>("endless");

TEST_F(LawsTest, AnEndlessLawIsToldWithItsTimeAndWhatItMayTake) {
  if (contain::kReportsFaults) GTEST_SKIP() << "the sanitizer wants SIGSEGV for itself";
  contain::FaultBarrier barrier = contain::open_barrier();
  contain::Watchdog dog(contain::WatchdogConfig{});
  ASSERT_TRUE(dog.watch(barrier));
  std::atomic<bool> stop{false};
  std::thread watching([&] { dog.run(stop); });
  use_cell(&barrier);
  arm_with(kPd);
  stage(kEndless);
  ticks(2);
  EXPECT_EQ(record_.law_id, 1u);
  for (const EventKind kind : {EventKind::law_faulted, EventKind::law_rolled_back}) {
    ASSERT_EQ(events(kind).size(), 1u);
    double took_us = 0;
    ASSERT_EQ(std::sscanf(events(kind)[0].text.data(), "overran: ended after %lf us, allowed 300.0", &took_us), 1)
        << events(kind)[0].text.data();
    EXPECT_GE(took_us, 300);
  }
  stop = true;
  watching.join();
}

TEST_F(LawsTest, AFaultInASlotSaysHowFarFromItsStart) {
  if (contain::kReportsFaults) GTEST_SKIP() << "the sanitizer wants SIGSEGV for itself";
  contain::FaultBarrier barrier = contain::open_barrier();
  use_cell(&barrier);
  arm_with(kPd);
  std::uint64_t pc = 0;
  for (const std::uint32_t before : {0u, 64u, 128u}) {
    law::Resident& crash = stage(kCrash);
    crash.code_address = pc == 0 ? 0 : pc - before;
    crash.code_bytes = 65;
    ticks(2);
    const auto fault = next_fault();
    ASSERT_TRUE(fault);
    EXPECT_EQ(fault->pc_offset, before == 64 ? 64u : 0u);
    pc = fault->pc;
  }
}

TEST_F(LawsTest, ALawsTimeGoesOnAfterItsReturn) {
  arm_with(kClock);
  ticks(100);
  const double before_s = record_.command_torque_nm[0] * 10;
  EXPECT_GT(before_s, 0.1);
  stage(kNotFinite);
  ticks(2);
  ASSERT_EQ(record_.law_id, 1u);
  EXPECT_NEAR(record_.command_torque_nm[0] * 10, before_s + 0.002, 1e-9) << "no second soft start in mid-motion";
}

// Where the processor has no keys for it.
TEST_F(LawsTest, ALawThatRaisesTheGuardsLimitsIsFoundOutAndTheyArePutBack) {
  auto protected_memory = contain::ProtectedMemory::make(1 << 16, contain::Protection::copies);
  ASSERT_TRUE(protected_memory) << protected_memory.message();
  contain::FaultBarrier barrier = contain::open_barrier(protected_memory->get());
  use_cell(&barrier);
  arm_with(kPd);
  publish(0.5);
  kPrey = std::as_writable_bytes(std::span(spine_.get(), 1));
  stage(kRaise);
  ticks(2);
  EXPECT_EQ(record_.law_id, 1u);
  const auto fault = next_fault();
  ASSERT_TRUE(fault);
  EXPECT_EQ(fault->kind, static_cast<std::uint32_t>(LawFaultKind::state_broken));
  kPrey = {};
  stage(kPush);
  ticks(40);
  EXPECT_NEAR(sent_.torque_nm[0], -0.6, 1e-9) << "as much as ever";
}

}  // namespace
}  // namespace lithe::loop
