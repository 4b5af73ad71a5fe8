// SPDX-License-Identifier: Apache-2.0
// With the segments of a Spine that is not there: what is answered, and how.
#include "supervisor/link/spine/commands.hpp"

#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <optional>
#include <string>
#include <vector>

#include "spine/ipc/mailbox.hpp"
#include "spine/ipc/segment.hpp"

namespace lithe::control {
namespace {

using wire::CommandKind;
using wire::CommandResult;
using wire::Fault;
using wire::Mode;

wire::Telemetry in_mode(Mode mode, Fault fault = Fault::none) {
  wire::Telemetry now{};
  now.mode = static_cast<std::uint32_t>(mode);
  now.fault = static_cast<std::uint32_t>(fault);
  return now;
}

TEST(RefusalOf, AdvisesByTheModeTheRobotIsIn) {
  struct Case {
    CommandKind kind;
    CommandResult result;
    wire::Telemetry now;
    std::string next;   // must occur in the advice
    std::string never;  // must not
  };
  const std::vector<Case> cases = {
      {CommandKind::hold, CommandResult::refused_mode, in_mode(Mode::disarmed), "lithe arm", "reset"},
      {CommandKind::hold, CommandResult::refused_mode, in_mode(Mode::disarmed, Fault::velocity_limit), "lithe reset",
       "arm first"},
      {CommandKind::hold, CommandResult::refused_mode, in_mode(Mode::safe_stop, Fault::drive_lost), "lithe reset",
       "arm first"},
      {CommandKind::hold, CommandResult::refused_mode, in_mode(Mode::estop, Fault::estop_pressed), "lithe reset",
       "arm first"},
      {CommandKind::reset, CommandResult::refused_mode, in_mode(Mode::disarmed), "lithe arm", "reset"},
      {CommandKind::reset, CommandResult::refused_mode, in_mode(Mode::active), "lithe disarm", "lithe arm"},
      {CommandKind::arm, CommandResult::refused_fault, in_mode(Mode::disarmed, Fault::drive_lost), "lithe reset",
       "first"},
      {CommandKind::arm, CommandResult::refused_estop, in_mode(Mode::estop, Fault::estop_pressed), "lithe reset",
       "Brain"},
      {CommandKind::disarm, CommandResult::refused_estop, in_mode(Mode::estop, Fault::estop_pressed), "lithe reset",
       "lithe arm"},
      {CommandKind::reset, CommandResult::refused_estop, in_mode(Mode::estop, Fault::estop_pressed), "Brain",
       "lithe arm"},
      {CommandKind::arm, CommandResult::refused_law, in_mode(Mode::disarmed), "lithe swap", "rollback"},
      {CommandKind::sim_reset, CommandResult::refused_mode, in_mode(Mode::estop, Fault::estop_pressed), "lithe reset",
       "disarm"},
      {CommandKind::sim_reset, CommandResult::refused_mode, in_mode(Mode::active), "lithe disarm", "lithe reset"},
      {CommandKind::set_params, CommandResult::refused_law, in_mode(Mode::active), "lithe param get", "swap"},
      {CommandKind::arm, CommandResult::refused_marked, in_mode(Mode::disarmed), "lithe activate", "lithe reset"},
  };
  for (const Case& each : cases) {
    const Refusal refusal = refusal_of(each.kind, each.result, each.now);
    const std::string where = std::string(to_string(each.kind)) + " in " + std::to_string(each.now.mode) + ": " +
                              refusal.message + " / " + refusal.next;
    EXPECT_EQ(refusal.code, to_string(each.result));
    EXPECT_NE(refusal.next.find(each.next), std::string::npos) << where;
    EXPECT_EQ(refusal.next.find(each.never), std::string::npos) << where;
  }
}

TEST(RefusalOf, NamesTheFaultThatIsLatched) {
  const Refusal refusal =
      refusal_of(CommandKind::arm, CommandResult::refused_fault, in_mode(Mode::safe_stop, Fault::velocity_limit));
  EXPECT_NE((refusal.message + refusal.next).find("velocity_limit"), std::string::npos);
}

TEST(RefusalOf, DamagedMemoryNeedsANewStartAndNothingElseIsAdvised) {
  const wire::Telemetry stopped = in_mode(Mode::safe_stop, Fault::memory_damaged);
  for (const CommandResult result :
       {CommandResult::refused_damaged, CommandResult::refused_fault, CommandResult::refused_mode}) {
    const Refusal refusal = refusal_of(CommandKind::hold, result, stopped);
    EXPECT_NE(refusal.next.find("lithe run"), std::string::npos) << refusal.next;
    EXPECT_EQ(refusal.next.find("lithe reset"), std::string::npos) << refusal.next;
  }
}

TEST(RefusalOf, NamesTheJointThatIsOutsideWithAngleLimitAndNextStep) {
  wire::Telemetry now = in_mode(Mode::disarmed);
  now.joint_count = 2;
  now.position_rad[1] = -3.5;
  wire::RobotInfo info{};
  std::copy_n("hip", 3, info.joint_name.begin());
  std::copy_n("knee", 4, info.joint_name.begin() + 32);
  info.position_min_rad.fill(-3);
  info.position_max_rad.fill(3);
  const Refusal refusal = refusal_of(CommandKind::arm, CommandResult::refused_outside, now, info);
  EXPECT_EQ(refusal.code, "refused_outside");
  EXPECT_EQ(refusal.message, "cannot arm: knee is at -3.500 rad, its limit is -3.000 rad");
  EXPECT_NE(refusal.next.find("lithe recover"), std::string::npos);
}

TEST(RefusalOf, NamesTheJointTheDriveAndWhyItIsNotReady) {
  namespace bit = wire::joint_status;
  wire::Telemetry now = in_mode(Mode::disarmed);
  now.joint_count = 3;
  now.joint_status[0] = bit::kFresh;
  now.joint_status[1] = bit::kFresh | bit::kNotReady;
  wire::RobotInfo info{};
  std::copy_n("hip", 3, info.joint_name.begin());
  std::copy_n("knee", 4, info.joint_name.begin() + 32);
  std::copy_n("toe", 3, info.joint_name.begin() + 64);
  robot::RobotConfig robot;
  for (std::size_t j = 0; j < 3; ++j) {
    robot.devices.push_back({.name = "drive" + std::to_string(j), .kind = robot::DeviceKind::cia402});
    robot.joints.emplace_back().device = j;
  }
  const Refusal refusal = refusal_of(CommandKind::arm, CommandResult::refused_not_ready, now, info, {&robot});
  EXPECT_EQ(
      refusal.message,
      "cannot arm: not every drive is ready: joint knee (drive drive1) has no heartbeat (1017h); joint toe (drive "
      "drive2) does not answer, or is being set up");
  EXPECT_NE(refusal.next.find("its power and cable"), std::string::npos);
  EXPECT_NE(refusal.next.find("lithe arm"), std::string::npos);
}

TEST(RefusalOf, ADriveThatReportsAFaultIsAFaultOfTheRobotInTheDrivesWords) {
  namespace bit = wire::joint_status;
  wire::Telemetry now = in_mode(Mode::disarmed);
  now.joint_count = 1;
  wire::RobotInfo info{};
  std::copy_n("hip", 3, info.joint_name.begin());
  robot::RobotConfig robot;
  robot.devices.push_back({.name = "drive0", .kind = robot::DeviceKind::cia402});
  robot.joints.emplace_back().device = 0;
  const auto words = [](robot::DeviceKind, std::uint32_t status) {
    return "fault " + std::to_string(status >> 8 & 0xff);
  };
  for (const std::uint32_t reports : {bit::kFault, bit::kWatchdog}) {
    now.joint_status[0] = bit::kFresh | reports | 7U << 8;
    const Refusal own = refusal_of(CommandKind::arm, CommandResult::refused_not_ready, now, info, {&robot, "", words});
    EXPECT_EQ(own.code, "refused_fault");
    EXPECT_EQ(own.message, "cannot arm: not every drive is ready: joint hip (drive drive0): its drive reports fault 7");
    EXPECT_NE(own.next.find("lithe reset"), std::string::npos) << own.next;
    const DriveFacts told{&robot, "lithe-spine: drive 'drive0': 606Ch is wrong", words};
    const Refusal ours = refusal_of(CommandKind::arm, CommandResult::refused_not_ready, now, info, told);
    EXPECT_EQ(
        ours.message,
        "cannot arm: not every drive is ready: joint hip (drive drive0): its drive reports fault 7; 606Ch is wrong");
    EXPECT_NE(ours.next.find("lithe reset"), std::string::npos) << ours.next;
  }
}

TEST(RefusalOf, NamesTheJointsThatAreNotHomed) {
  wire::Telemetry now = in_mode(Mode::disarmed);
  now.joint_count = 3;
  now.joint_status[0] = now.joint_status[2] = wire::joint_status::kNotHomed;
  wire::RobotInfo info{};
  std::copy_n("hip", 3, info.joint_name.begin());
  std::copy_n("knee", 4, info.joint_name.begin() + 32);
  std::copy_n("toe", 3, info.joint_name.begin() + 64);
  robot::RobotConfig robot;
  robot.joints.resize(3);
  robot.joints[1].must_be_homed = robot.joints[2].must_be_homed = true;
  const Refusal refusal = refusal_of(CommandKind::arm, CommandResult::refused_not_homed, now, info, {&robot});
  EXPECT_EQ(refusal.message, "cannot arm: a joint with must_be_homed does not know in which turn it is: joint toe");
  EXPECT_EQ(refusal.next, "home it, then: lithe arm");
  now.joint_status[2] = 0;
  const Refusal late = refusal_of(CommandKind::arm, CommandResult::refused_not_homed, now, info, {&robot});
  EXPECT_EQ(late.next, "try again; lithe status names the joints that are stale") << "homed since";
}

TEST(RefusalOf, SaysWhatTheSpineToldOfADriveThatIsNotReady) {
  namespace bit = wire::joint_status;
  wire::Telemetry now = in_mode(Mode::disarmed);
  now.joint_count = 2;
  now.joint_status[0] = now.joint_status[1] = bit::kFresh | bit::kNotReady;
  wire::RobotInfo info{};
  std::copy_n("hip", 3, info.joint_name.begin());
  std::copy_n("knee", 4, info.joint_name.begin() + 32);
  robot::RobotConfig robot;
  for (std::size_t j = 0; j < 2; ++j) {
    robot.devices.push_back({.name = "drive" + std::to_string(j)});
    robot.joints.emplace_back().device = j;
  }
  const std::string line =
      "lithe-spine: bus 'can0': down; drive 'drive1': servo.timeout_mode is 10: it would go on; set it to 12; "
      "device 'drive1x': silent";
  const auto told = drives_told_in(line);
  ASSERT_TRUE(told);
  const Refusal refusal = refusal_of(CommandKind::arm, CommandResult::refused_not_ready, now, info, {&robot, *told});
  EXPECT_EQ(refusal.message,
            "cannot arm: not every drive is ready: joint hip (drive drive0) is not set up as a command would need it; "
            "the log says what to set; joint knee (drive drive1): servo.timeout_mode is 10: it would go on; set it to "
            "12");
  EXPECT_NE(refusal.next.find("lithe arm"), std::string::npos);
  EXPECT_EQ(drives_told_in("lithe-spine: all buses and drives are well"), "") << "nothing is kept of what is over";
  EXPECT_FALSE(drives_told_in("lithe-spine: a law can make system calls"));
  EXPECT_FALSE(drives_told_in("drive 'drive1': from elsewhere"));
}

class CommandsTest : public testing::Test {
 protected:
  CommandsTest() {
    ipc::ChannelWriter<wire::RobotInfo>(spine_->robot_info).write(wire::RobotInfo{});
    auto link = SpineLink::attach("ghost");
    EXPECT_TRUE(link) << link.message();
    link_.emplace(std::move(*link));
  }
  ~CommandsTest() override {
    ipc::remove_segment(ipc::Segment<ipc::SpineMemory>::path("ghost"));
    ipc::remove_segment(ipc::Segment<ipc::ControlMemory>::path("ghost"));
  }
  // The Spine's part: takes the next command, and answers it.
  bool receive_and_answer(CommandResult result) {
    wire::Command command;
    std::uint64_t ticket = 0;
    if (!inbox_.receive(command, ticket)) return false;
    inbox_.answer(ticket, static_cast<std::uint32_t>(result));
    return true;
  }
  template <class Memory>
  static ipc::Segment<Memory> made() {
    ::setenv("LITHE_SHM_PREFIX", ("lithe-commands-" + std::to_string(::getpid())).c_str(), 1);
    auto segment = ipc::Segment<Memory>::create("ghost");
    EXPECT_TRUE(segment) << segment.message();
    return std::move(*segment);
  }
  ipc::Segment<ipc::SpineMemory> spine_ = made<ipc::SpineMemory>();
  ipc::Segment<ipc::ControlMemory> control_ = made<ipc::ControlMemory>();
  decltype(ipc::MailboxReceiver(control_->commands, spine_->control_ack)) inbox_{control_->commands,
                                                                                 spine_->control_ack};
  std::optional<SpineLink> link_;
};

TEST_F(CommandsTest, AnAnswerThatDoesNotComeIsNotConfirmedAndNotCalledAFailure) {
  Commands commands(*link_, 1);
  std::optional<Answer> answer;
  wire::Command arm;
  arm.kind = static_cast<std::uint32_t>(CommandKind::arm);
  commands.send(arm, [&answer](const Answer& got) { answer = got; }, 0);
  commands.serve(Commands::kTimeoutNs - 1);
  EXPECT_FALSE(answer);
  commands.serve(Commands::kTimeoutNs);
  ASSERT_TRUE(answer && std::holds_alternative<Refusal>(*answer));
  const Refusal& refusal = std::get<Refusal>(*answer);
  EXPECT_EQ(refusal.code, "timeout");
  EXPECT_NE(refusal.message.find("arm is not confirmed"), std::string::npos);
  EXPECT_NE(refusal.message.find("may still take effect"), std::string::npos);
  EXPECT_FALSE(commands.waiting());
}

TEST_F(CommandsTest, AFullMailboxIsBusy) {
  Commands commands(*link_, 1);
  std::vector<std::string> codes;
  for (std::size_t i = 0; i <= wire::control_segment::kCommandsDepth; ++i)
    commands.send(wire::Command{}, [&codes](const Answer& got) { codes.push_back(std::get<Refusal>(got).code); }, 0);
  EXPECT_EQ(codes, (std::vector<std::string>{"busy"}));
}

wire::Command of(CommandKind kind) {
  wire::Command command;
  command.kind = static_cast<std::uint32_t>(kind);
  return command;
}

TEST_F(CommandsTest, AnArmThatIsSentAgainDoesNotOutliveTheDisarmAfterIt) {
  for (const CommandKind stop : {CommandKind::disarm, CommandKind::estop}) {
    Commands commands(*link_, 1);
    std::string code;
    commands.send(of(CommandKind::arm), [&code](const Answer& got) { code = std::get<Refusal>(got).code; }, 0);
    ASSERT_TRUE(receive_and_answer(CommandResult::refused_not_ready));
    commands.serve(1);
    commands.send(of(stop), [](const Answer&) {}, 2);
    ASSERT_TRUE(receive_and_answer(CommandResult::refused_not_ready)) << "it is sent again";
    ASSERT_TRUE(receive_and_answer(CommandResult::done));
    commands.serve(3);
    EXPECT_FALSE(receive_and_answer(CommandResult::done)) << "armed after " << to_string(stop);
    EXPECT_EQ(code, "refused_not_ready");
  }
}

TEST_F(CommandsTest, ACommandThatEndsInAStopAtOnceIsNoSuccess) {
  struct Case {
    CommandKind kind;
    Mode mode;
    Fault fault;
    bool refused;
  };
  std::vector<Case> cases = {{CommandKind::arm, Mode::active, Fault::none, false},
                             {CommandKind::arm, Mode::active, Fault::drive_lost, false},  // of another group
                             {CommandKind::disarm, Mode::disarmed, Fault::drive_fault, false},
                             {CommandKind::estop, Mode::estop, Fault::estop_pressed, false},
                             {CommandKind::arm, Mode::estop, Fault::estop_pressed, true}};
  for (const Fault fault : {Fault::law_faulted, Fault::brain_stale, Fault::law_not_finite, Fault::drive_fault,
                            Fault::velocity_limit, Fault::sample_stale})
    for (const CommandKind kind : {CommandKind::arm, CommandKind::hold, CommandKind::recover})
      cases.push_back({kind, Mode::safe_stop, fault, true});
  std::uint64_t tick = 0;
  for (const auto& [kind, mode, fault, refused] : cases) {
    const bool of_its_law = fault == Fault::law_faulted || fault == Fault::law_not_finite;
    Commands commands(*link_, 1);
    std::optional<Answer> answer;
    commands.send(of(kind), [&answer](const Answer& got) { answer = got; }, 0);
    ASSERT_TRUE(receive_and_answer(CommandResult::done));
    commands.serve(1);
    wire::Telemetry now = in_mode(mode, fault);
    now.tick = tick += 10;
    ipc::RingWriter(spine_->telemetry).push(now);
    commands.serve(2);
    ASSERT_TRUE(answer);
    ASSERT_EQ(std::holds_alternative<Refusal>(*answer), refused) << to_string(kind) << ' ' << to_string(fault);
    if (!refused) continue;
    const Refusal& why = std::get<Refusal>(*answer);
    EXPECT_EQ(why.code, "refused_fault") << "exit code 3";
    EXPECT_NE(why.message.find(to_string(fault)), std::string::npos);
    EXPECT_EQ(why.detail["fault"], to_string(fault));
    EXPECT_EQ(why.next.find("lithe swap") != std::string::npos, of_its_law) << why.next;
  }
}

TEST_F(CommandsTest, AnArmIsAnsweredWhenEveryDriveHasTorqueOrIsStillWithoutItAfterAWhile) {
  for (const bool driven : {true, false}) {
    Commands commands(*link_, 1);
    std::optional<Answer> answer;
    commands.send(of(CommandKind::arm), [&answer](const Answer& got) { answer = got; }, 0);
    ASSERT_TRUE(receive_and_answer(CommandResult::done));
    commands.serve(1);
    wire::Telemetry now = in_mode(Mode::active);
    now.tick = driven ? 10 : 20;
    now.joint_count = 1;
    now.drive_state[0] = static_cast<std::uint32_t>(wire::DriveState::enabling);
    ipc::RingWriter(spine_->telemetry).push(now);
    commands.serve(Commands::kDrivenNs - 1);
    ASSERT_FALSE(answer);
    if (driven) {
      now.drive_state[0] = static_cast<std::uint32_t>(wire::DriveState::driven);
      ipc::RingWriter(spine_->telemetry).push(now);
    }
    commands.serve(Commands::kDrivenNs - (driven ? 1 : 0));
    ASSERT_TRUE(answer && std::holds_alternative<Json>(*answer));
  }
}

TEST_F(CommandsTest, WhileTheRobotIsShutDownOnlyAStopIsSent) {
  Commands commands(*link_, 1);
  commands.close({"stopping", "the robot is being stopped", ""});
  std::vector<std::string> codes;
  const auto note = [&codes](const Answer& got) { codes.push_back(std::get<Refusal>(got).code); };
  EXPECT_EQ(commands.send(of(CommandKind::arm), note, 0), 0u);
  EXPECT_EQ(commands.send(of(CommandKind::recover), note, 0), 0u);
  EXPECT_EQ(codes, (std::vector<std::string>{"stopping", "stopping"}));
  EXPECT_NE(commands.send(of(CommandKind::disarm), note, 0), 0u);
  EXPECT_NE(commands.send(of(CommandKind::estop), note, 0), 0u);
}

}  // namespace
}  // namespace lithe::control
