// SPDX-License-Identifier: Apache-2.0
// What comes broken is counted where a user can see it.
#include <gtest/gtest.h>

#include "spine/loop/test/tick_rig.hpp"

namespace lithe::loop {
namespace {

TEST_F(TickTest, ASoundBrainAndSupervisorLeaveHealthAtZero) {
  arm_with(kPd);
  for (int i = 0; i < 50; ++i) {
    publish(0.1);
    tick();
  }
  EXPECT_EQ(memory_->health.plans_torn, 0U);
  EXPECT_EQ(memory_->health.brain_violations, 0U);
  EXPECT_EQ(memory_->health.control_violations, 0U);
}

TEST_F(TickTest, APlanThatIsNeverWholeIsCountedEachTimeItIsGivenUp) {
  arm_with(kPd);
  brain_memory_->plan.slots[1].record.sequence = 2 * 5 + 1;  // its writer died in the middle of plan 5 ...
  brain_memory_->plan.latest = 5;                            // ... which it had announced: no writer of ours does
  ticks(3);
  EXPECT_EQ(memory_->health.plans_torn, 3U);
  EXPECT_EQ(mode(), Mode::active);
}

// The same robot, whose file calls a torn plan a fault.
class TornPlanTest : public testing::Test, protected TickBench {
 protected:
  TornPlanTest() : TickBench(robot_that_stops()) {}

  static robot::RobotConfig robot_that_stops() {
    robot::RobotConfig robot = *robot::parse_robot(kRobot, "probe.toml");
    robot.brain.on_torn_plan = robot::MissPolicy::stop;
    return robot;
  }
  void announce_half_a_plan() {  // and never finish it
    brain_memory_->plan.slots[1].record.sequence = 2 * 5 + 1;
    brain_memory_->plan.latest = 5;
  }
};

TEST_F(TornPlanTest, StopsTheRobotInTheTickThatGaveUpAndSaysWhy) {
  arm_with(kPd);
  ipc::RingReader<wire::Event, wire::spine_segment::kEventsTickDepth> events(memory_->events_tick);
  announce_half_a_plan();
  tick();
  EXPECT_EQ(mode(), Mode::safe_stop);
  EXPECT_EQ(static_cast<wire::Fault>(record_.fault), wire::Fault::plan_torn);
  EXPECT_EQ(memory_->health.plans_torn, 1U);
  wire::Event event;
  bool told = false;
  while (events.next(event)) {
    told = told || (event.kind == static_cast<std::uint32_t>(wire::EventKind::safe_stop) &&
                    event.code == static_cast<std::uint32_t>(wire::Fault::plan_torn));
  }
  EXPECT_TRUE(told);
}

TEST_F(TornPlanTest, ABrainThatWritesWholePlansAgainLeadsBack) {
  arm_with(kPd);
  announce_half_a_plan();
  ticks(3);
  ASSERT_EQ(mode(), Mode::safe_stop);
  EXPECT_EQ(send(CommandKind::arm), CommandResult::refused_fault);
  publish(0.1);
  tick();
  EXPECT_EQ(send(CommandKind::reset), CommandResult::done);
  ticks(3);
  EXPECT_EQ(send(CommandKind::arm), CommandResult::done);
  publish(0.1);
  ticks(3);
  EXPECT_EQ(mode(), Mode::active);
}

TEST_F(TornPlanTest, IsNoFaultWhileNoPlanIsFollowed) {
  arm_with(kPd);
  ASSERT_EQ(send(CommandKind::hold), CommandResult::done);
  announce_half_a_plan();
  ticks(3);
  EXPECT_EQ(mode(), Mode::hold);
  EXPECT_EQ(memory_->health.plans_torn, 3U) << "counted all the same";
}

TEST_F(TornPlanTest, AWriterThatDiesInThePlanAfterTheLastOneTearsNothing) {
  arm_with(kPd);
  publish(0.1);
  tick();
  brain_memory_->plan.slots[2].record.sequence = 2 * 2 + 1;  // plan 2, not announced: plan 1 stays whole
  for (int i = 0; i < 200; ++i) {
    brain_memory_->header.heartbeat_ns = now_ns_;
    tick();
  }
  EXPECT_EQ(mode(), Mode::active);
  EXPECT_EQ(memory_->health.plans_torn, 0U);
}

// What the Brain writes into its own mailbox has not been tried.
class MailboxParamsTest : public testing::Test, protected TickBench {
 protected:
  MailboxParamsTest() : TickBench(*robot::parse_robot(kRobot, "probe.toml")) {}

  static wire::Command gain_of(double value) {
    wire::Command command;
    command.kind = static_cast<std::uint32_t>(CommandKind::set_params);
    command.count = 1;
    command.value[0] = value;
    return command;
  }
  CommandResult brain_sends(const wire::Command& command) {
    const auto ticket = brain_.send(command);
    EXPECT_TRUE(ticket);
    tick();
    return static_cast<CommandResult>(brain_.poll(*ticket));
  }

  ipc::MailboxSender<wire::Command, 16> brain_{brain_memory_->commands, memory_->brain_ack};
};

TEST_F(MailboxParamsTest, AreRefusedWhileASupervisorCouldTryThemAndTheReasonIsTold) {
  arm_with(kPd);
  ipc::RingReader<wire::Event, wire::spine_segment::kEventsTickDepth> events(memory_->events_tick);
  supervised_ = true;
  for (const std::int64_t silent_ns : {std::int64_t{0}, 900 * kNsPerMs, 60 * kNsPerS}) {
    control_memory_->header.heartbeat_ns = now_ns_ - silent_ns;
    EXPECT_EQ(brain_sends(gain_of(8)), CommandResult::refused_untried) << silent_ns;
  }
  EXPECT_EQ(slot_.active()->params[0].value, 4.0);
  wire::Event event;
  ASSERT_TRUE(events.next(event));
  EXPECT_EQ(event.kind, static_cast<std::uint32_t>(wire::EventKind::command_refused));
  EXPECT_EQ(event.code, static_cast<std::uint32_t>(CommandResult::refused_untried));
  EXPECT_NE(std::string(event.text.data()).find("which tries them"), std::string::npos);
  EXPECT_EQ(send(gain_of(8)), CommandResult::done) << "the supervisor's own have been tried";
  EXPECT_EQ(slot_.active()->params[0].value, 8.0);
}

TEST_F(MailboxParamsTest, AreTakenWhenNobodyLivesToTryThem) {
  arm_with(kPd);
  EXPECT_EQ(brain_sends(gain_of(8)), CommandResult::done) << "no supervisor yet";
  supervised_ = true;
  EXPECT_EQ(brain_sends(gain_of(6)), CommandResult::refused_untried);
  supervised_ = false;
  control_memory_->header.heartbeat_ns = now_ns_;
  EXPECT_EQ(brain_sends(gain_of(7)), CommandResult::done) << "it has just died";
  EXPECT_EQ(slot_.active()->params[0].value, 7.0);
}

TEST_F(MailboxParamsTest, AreTheOnlyThingThatASupervisorKeepsFromTheMailbox) {
  arm_with(kPd);
  supervised_ = true;
  wire::Command command;
  for (const CommandKind kind : {CommandKind::revert_params, CommandKind::hold, CommandKind::disarm}) {
    command.kind = static_cast<std::uint32_t>(kind);
    EXPECT_EQ(brain_sends(command), CommandResult::done);
  }
}

TEST_F(TickTest, ImpossibleHeadsAndBrokenLettersAreCountedBySender) {
  arm_with(kPd);
  brain_memory_->commands.head += 1000;
  tick();
  EXPECT_EQ(memory_->health.brain_violations, 1U);
  ++brain_memory_->commands.head;  // a letter that was announced and never written
  tick();
  EXPECT_EQ(memory_->health.brain_violations, 2U);
  EXPECT_EQ(memory_->health.control_violations, 0U);
  control_memory_->commands.head += 17;
  tick();
  EXPECT_EQ(memory_->health.control_violations, 1U);
  EXPECT_EQ(memory_->health.brain_violations, 2U);
  EXPECT_EQ(mode(), Mode::active);
}

}  // namespace
}  // namespace lithe::loop
