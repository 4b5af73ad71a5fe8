// SPDX-License-Identifier: Apache-2.0
// What the tick does with laws, with every real part around it.
#include <algorithm>
#include <vector>

#include "spine/contain/cell.hpp"
#include "spine/loop/tick_bench.hpp"

namespace lithe::loop {
namespace {

using wire::EventKind;
using wire::LawFaultKind;
namespace flag = wire::telemetry_flag;

// Pd with another structure: a constant more, and a state of its own.
struct Lifted {
  struct Params {};
  struct State {
    double integral_rad_s = 0;
    double calls = 0;
  };
  static void step(const Tick& t, const Params&, State& s, Effort& u) {
    s.calls += 1;
    u.torque_nm[0] = 4.0 * (t.setpoint_position_rad[0] - t.position_rad[0]) - 0.1 * t.velocity_rad_s[0] + 0.3;
  }
};
struct LateNan {  // finite for ten steps
  struct Params {};
  struct State {
    double steps = 0;
  };
  static void step(const Tick&, const Params&, State& s, Effort& u) {
    u.torque_nm[0] = ++s.steps > 10 ? std::numeric_limits<double>::quiet_NaN() : 0.0;
  }
};
volatile std::uintptr_t kNowhere = 8;
struct Crash {
  struct Params {};
  struct State {};
  static void step(const Tick&, const Params&, State&, Effort& u) {
    u.torque_nm[0] = *reinterpret_cast<const double*>(kNowhere);
  }
};
struct Scribble {  // over everything it is given, and through the const
  struct Params {
    Param gain{1, 0, 2};
  };
  struct State {
    double integral_rad_s = 0;
  };
  static void step(const Tick& t, const Params& p, State& s, Effort& u) {
    std::memset(const_cast<void*>(static_cast<const void*>(&t)), 0xff, sizeof t);
    std::memset(const_cast<void*>(static_cast<const void*>(&p)), 0xff, sizeof p);
    std::memset(static_cast<void*>(&s), 0xff, sizeof s);
    u.torque_nm[0] = std::numeric_limits<double>::infinity();
  }
};

constexpr LitheLaw kLifted = describe<Lifted>("lifted");
constexpr LitheLaw kLateNan = describe<LateNan>("late_nan");
constexpr LitheLaw kCrash = describe<Crash>("crash");
constexpr LitheLaw kScribble = describe<Scribble>("scribble");

class LawsTest : public TickTest {
 protected:
  std::vector<wire::Event> events(EventKind kind) {
    for (std::optional<wire::Event> event = next_event(); event; event = next_event()) all_.push_back(*event);
    std::vector<wire::Event> found;
    std::copy_if(all_.begin(), all_.end(), std::back_inserter(found),
                 [kind](const wire::Event& e) { return e.kind == static_cast<std::uint32_t>(kind); });
    return found;
  }
  std::optional<wire::Event> next_event() {
    wire::Event event{};
    if (!event_reader_.next(event)) return std::nullopt;
    return event;
  }
  std::optional<wire::LawFault> next_fault() {
    wire::LawFault fault{};
    if (!fault_reader_.next(fault)) return std::nullopt;
    return fault;
  }
  wire::ShadowReport shadow_report() const {
    wire::ShadowReport report{};
    ipc::ChannelReader<wire::ShadowReport>(memory_->shadow).read(report);
    return report;
  }

  ipc::RingReader<wire::Event, wire::spine_segment::kEventsTickDepth> event_reader_{memory_->events_tick};
  ipc::RingReader<wire::LawFault, wire::spine_segment::kLawFaultsDepth> fault_reader_{memory_->law_faults};
  std::vector<wire::Event> all_;
};

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

TEST_F(LawsTest, WithoutALawBeforeItTheSafeLawTakesOverInTheSameTick) {
  arm_with(kLateNan);
  while (mode() == Mode::active && record_.tick < 100) tick();
  EXPECT_EQ(mode(), Mode::safe_stop);
  EXPECT_EQ(static_cast<wire::Fault>(record_.fault), wire::Fault::law_not_finite);
  EXPECT_NE(record_.flags & flag::kNotFinite, 0u);
  for (int i = 0; i < 500; ++i) {
    tick();
    ASSERT_TRUE(std::isfinite(sent_.torque_nm[0]));
    ASSERT_LE(std::abs(sent_.torque_nm[0]), 0.6);
  }
  EXPECT_EQ(send(CommandKind::arm), CommandResult::refused_fault);
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
  EXPECT_EQ(next_fault()->law_id, 3u);
  EXPECT_EQ(next_fault()->law_id, 2u);
  EXPECT_EQ(slot_.active()->law_id, 1u) << "what runs after a reset";
}

TEST_F(LawsTest, ASensorThatIsNotANumberIsNotTheLawsFault) {
  arm_with(kPd);
  stage(kPd);
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

TEST_F(LawsTest, ALawThatCrashesIsReplacedInTheSameTick) {
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
  GTEST_SKIP() << "the sanitizer wants SIGSEGV for itself";
#endif
  ASSERT_TRUE(contain::install_handlers());
  auto cell = contain::Cell::open();
  ASSERT_TRUE(cell) << cell.message();
  use_cell(&*cell);
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
  }
}

}  // namespace
}  // namespace lithe::loop
