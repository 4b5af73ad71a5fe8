// SPDX-License-Identifier: Apache-2.0
// Beyond its limits a robot is not armed; recover brings it back, slowly and with little torque, or says why not.
#include <gtest/gtest.h>

#include <string>

#include "spine/loop/test/recover_rig.hpp"

namespace lithe::loop {
namespace {

struct RecoverRig : RecoverBench {
  RecoverRig(double rate_hz, const std::vector<JointText>& joints) : RecoverRig(robot_of(rate_hz, joints)) {}
  explicit RecoverRig(const robot::RobotConfig& robot) : RecoverBench(robot) {
    stage(kPdAll);
    ticks(8);
  }
  double steps() { return reinterpret_cast<const PdAll::State*>(slot_.active()->state.data())->steps; }
  std::string last_event(wire::EventKind kind) {
    ipc::RingReader<wire::Event, wire::spine_segment::kEventsTickDepth> events(memory_->events_tick);
    events.rewind();
    std::string text;
    wire::Event event;
    while (events.next(event))
      if (event.kind == static_cast<std::uint32_t>(kind)) text = event.text.data();
    return text;
  }
  using TickBench::brain_memory_;
  using TickBench::control_memory_;
  using TickBench::record_;
  using TickBench::robot_;
  using TickBench::sent_;
};

struct Case {
  double rate_hz;
  std::vector<JointText> joints;
};

std::vector<Case> cases() {
  return {{1000, {{-3, 3, 3.6}}},                                // beyond the overrun, gravity pulls further out
          {1000, {{-1, 1, 2.0}}},                                // gravity helps
          {1000, {{1, 2, 0}}},                                   // hangs at rest, below its range
          {100, {{1, 2, 0}, {-3, 3, 6.28}}},                     //
          {10000, {{-1, 1, 1.3}}},                               //
          {1000, {{1, 2, 0}, {-3, 3, 0.5}, {-0.5, 0.5, -1.2}}},  // one of them is inside
          {500, {{-3, 3, 4.2, 0.0}, {-2, -1, 1.0, 0.0}}}};       // nothing but friction
}

TEST(Recover, BringsEveryJointInsideSlowlyWithLittleTorqueAndThenTheRobotCanBeArmed) {
  for (const Case& each : cases()) {
    RecoverRig rig(each.rate_hz, each.joints);
    const std::string where = fmt::format("{} Hz, joint 0 from {}", each.rate_hz, each.joints[0].start_rad);
    ASSERT_EQ(rig.send(CommandKind::arm), CommandResult::refused_outside) << where;
    ASSERT_EQ(rig.mode(), Mode::disarmed);
    ASSERT_EQ(rig.send(CommandKind::recover), CommandResult::done) << where;
    double fastest = 0, strongest = 0;
    for (int i = rig.ticks_in(30); i > 0 && rig.recovering(); --i) {
      rig.tick();
      ASSERT_EQ(rig.mode(), Mode::recover) << where << " " << rig.last_event(wire::EventKind::safe_stop);
      for (std::size_t j = 0; j < each.joints.size(); ++j) {
        const double inwards = rig.record_.position_rad[j] > each.joints[j].max_rad ? -1 : 1;
        if (!rig.inside(j)) fastest = std::max(fastest, inwards * rig.record_.velocity_rad_s[j]);
        strongest = std::max(strongest, std::abs(rig.record_.command_torque_nm[j]));
      }
    }
    EXPECT_FALSE(rig.recovering()) << where;
    EXPECT_TRUE(rig.all_inside()) << where;
    EXPECT_LE(strongest, kRecoverShare * kTorqueMaxNm + 1e-9) << where;
    EXPECT_LT(fastest, 3 * kRecoverRadS) << where;  // with gravity's help, before the load is found
    rig.ticks(rig.ticks_in(1));
    EXPECT_TRUE(rig.all_inside()) << where << ": it is held there";
    ASSERT_EQ(rig.send(CommandKind::arm), CommandResult::done) << where;
    rig.ticks(rig.ticks_in(each.rate_hz < 500 ? 0.1 : 1.0));  // the law is none for 100 Hz
    EXPECT_EQ(rig.mode(), Mode::active) << where << " " << rig.last_event(wire::EventKind::safe_stop);
  }
}

TEST(Recover, NoLawRunsMeanwhileAndTheTorqueNeverJumps) {
  RecoverRig rig(1000, {{1, 2, 0}});
  const double before = rig.steps();
  ASSERT_EQ(rig.send(CommandKind::recover), CommandResult::done);
  double last_nm = rig.record_.command_torque_nm[0];
  for (int i = 0; i < 2000; ++i) {
    rig.tick();
    ASSERT_LE(std::abs(rig.record_.command_torque_nm[0] - last_nm), 0.12 + 1e-9);
    last_nm = rig.record_.command_torque_nm[0];
  }
  EXPECT_EQ(rig.steps(), before);
}

TEST(Recover, ALoadAboveItsTorqueEndsInTheSafeStopWithJointAndReason) {
  RecoverRig rig(1000, {{-3, 3, 0}, {1, 2, 0, 0.5}});  // 0.42 Nm at 1 rad, of 0.3
  ASSERT_EQ(rig.send(CommandKind::recover), CommandResult::done);
  ASSERT_TRUE(rig.finish_recovery(60));
  EXPECT_EQ(rig.mode(), Mode::safe_stop);
  EXPECT_EQ(rig.fault(), wire::Fault::recover_failed);
  EXPECT_EQ(static_cast<wire::Fault>(rig.record_.joint_fault[0]), wire::Fault::none);
  EXPECT_EQ(static_cast<wire::Fault>(rig.record_.joint_fault[1]), wire::Fault::recover_failed);
  EXPECT_EQ(rig.last_event(wire::EventKind::safe_stop),
            "recover_failed at joint joint1: the recover torque does not move it (load, or a stop)");
  EXPECT_EQ(rig.send(CommandKind::arm), CommandResult::refused_fault);
  EXPECT_EQ(rig.send(CommandKind::recover), CommandResult::done) << "once more, from the safe stop";
}

TEST(Recover, TheEstopWinsAtAnyTime) {
  for (const int after : {1, 20, 700}) {
    RecoverRig rig(1000, {{1, 2, 0}});
    ASSERT_EQ(rig.send(CommandKind::recover), CommandResult::done);
    rig.ticks(after);
    rig.control_memory_->estop.value = 1;
    rig.ticks(2);
    EXPECT_EQ(rig.mode(), Mode::estop);
    EXPECT_EQ(rig.sent_.action[0], hal::DriveAction::damp);
    EXPECT_EQ(rig.send(CommandKind::recover), CommandResult::refused_estop);
  }
}

TEST(Recover, AnyOtherFaultEndsIt) {
  RecoverRig rig(1000, {{1, 2, 0}});
  ASSERT_EQ(rig.send(CommandKind::recover), CommandResult::done);
  rig.ticks(100);
  for (int i = 0; i < 8; ++i) rig.tick(false);  // the bus is late
  EXPECT_EQ(rig.mode(), Mode::safe_stop);
  EXPECT_EQ(rig.fault(), wire::Fault::sample_stale);
  const std::string last = std::to_string(rig.robot_.spine.late_ticks_to_stop);
  EXPECT_EQ(rig.last_event(wire::EventKind::safe_stop).rfind("sample_stale: " + last + " ticks in a row", 0), 0U)
      << rig.last_event(wire::EventKind::safe_stop);
  rig.serve();
  rig.ticks(3);
  EXPECT_EQ(rig.send(CommandKind::recover), CommandResult::refused_fault) << "not what recover is the way out of";
  EXPECT_EQ(rig.send_off(CommandKind::reset), CommandResult::done);
  rig.ticks(5);
  EXPECT_EQ(rig.send(CommandKind::recover), CommandResult::done);
}

// The guard of this robot does not know how its joint can be stopped.
TEST(Recover, AJointThatRunsBeyondIsHeldAndNeedNotFallFirst) {
  robot::RobotConfig undeclared = robot_of(1000, {{-3, 3, 0.5}});
  undeclared.joints[0].inertia_max_kg_m2 = 0;
  RecoverRig rig(undeclared);
  ASSERT_EQ(rig.send(CommandKind::arm), CommandResult::done);
  rig.stage(kPushUp);
  for (int i = 0; i < 2000 && rig.mode() == Mode::active; ++i) rig.tick();
  ASSERT_EQ(rig.mode(), Mode::safe_stop);
  EXPECT_EQ(rig.send(CommandKind::arm), CommandResult::refused_fault);
  rig.stage(kPdAll);
  rig.ticks(300);
  ASSERT_EQ(rig.send(CommandKind::recover), CommandResult::done);
  ASSERT_TRUE(rig.finish_recovery(30));
  ASSERT_EQ(rig.mode(), Mode::recover) << rig.last_event(wire::EventKind::safe_stop);
  EXPECT_EQ(rig.send(CommandKind::arm), CommandResult::done);
}

TEST(SimReset, PutsTheJointsBackWhereTheyBegan) {
  RecoverRig rig(1000, {{-3, 3, 0.5}, {-3, 3, -1.0}});
  rig.ticks(2000);
  ASSERT_GT(std::abs(rig.record_.position_rad[1] + 1.0), 0.3) << "it has fallen";
  ASSERT_EQ(rig.send(CommandKind::sim_reset), CommandResult::done);
  rig.ticks(3);
  EXPECT_NEAR(rig.record_.position_rad[0], 0.5, 0.01);
  EXPECT_NEAR(rig.record_.position_rad[1], -1.0, 0.01);
  EXPECT_LT(std::abs(rig.record_.velocity_rad_s[1]), 1.0) << "put there, not thrown there";
}

TEST(SimReset, IsRefusedWhileDrivesAreOnAndOnRealBuses) {
  RecoverRig rig(1000, {{-3, 3, 0.5}});
  ASSERT_EQ(rig.send(CommandKind::arm), CommandResult::done);
  EXPECT_EQ(rig.send(CommandKind::sim_reset), CommandResult::refused_mode);
  EXPECT_EQ(rig.send_off(CommandKind::disarm), CommandResult::done);
  EXPECT_EQ(rig.send(CommandKind::sim_reset), CommandResult::done);
  rig.robot_.buses[0].kind = robot::BusKind::fdcanusb;
  rig.use_cell(nullptr);
  EXPECT_EQ(rig.send(CommandKind::sim_reset), CommandResult::refused_not_simulated);
}

}  // namespace
}  // namespace lithe::loop
