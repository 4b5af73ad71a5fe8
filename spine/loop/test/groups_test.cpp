// SPDX-License-Identifier: Apache-2.0
// A robot of which a part has stopped: what the tick says, what leaves, and what swaps make of it.
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <limits>
#include <string>

#include "spine/loop/test/tick_rig.hpp"

namespace lithe::loop {
namespace {

constexpr std::size_t kLeg = 0, kArm = 1;

robot::RobotConfig two_groups() {
  robot::RobotConfig robot = *robot::parse_robot(kRobot, "probe.toml");
  robot.guard.other_groups = robot::OtherGroups::go_on;
  robot.guard.brake_after_s = 0.2;
  robot.guard.off_after_s = 0.4;
  robot.devices.push_back(robot.devices[0]);
  robot.devices[1].id = 2;
  robot.joints.push_back(robot.joints[0]);
  robot.joints[kLeg].group = "leg";
  robot.joints[kArm].name = "elbow";
  robot.joints[kArm].group = "arm";
  robot.joints[kArm].device = 1;
  return robot;
}

// PD on both joints; `lift_nm` more on the leg.
template <int kLiftMilliNm>
struct Both {
  struct Params {};
  struct State {};
  static void step(const Tick& t, const Params&, State&, Effort& u) {
    for (std::uint32_t j = 0; j < t.joints; ++j)
      u.torque_nm[j] = 4 * (t.setpoint_position_rad[j] - t.position_rad[j]) - 0.1 * t.velocity_rad_s[j];
    u.torque_nm[kLeg] += 1e-3 * kLiftMilliNm;
  }
};
constexpr LitheLaw kBoth = describe<Both<0>>("both");
constexpr LitheLaw kLift = describe<Both<500>>("lift");

struct NanLeg {
  struct Params {};
  struct State {};
  static void step(const Tick&, const Params&, State&, Effort& u) { u.torque_nm[kLeg] = std::nan(""); }
};
constexpr LitheLaw kNanLeg = describe<NanLeg>("nan_leg");
// What it makes of a leg that is gone stays in its State.
struct Spoilt {
  static inline bool leg_is_gone = false;
  struct Params {};
  struct State {
    double leg_nm = 0;
    double count = 0;
  };
  static void step(const Tick&, const Params&, State& s, Effort& u) {
    if (leg_is_gone) s.leg_nm = std::nan("");
    ++s.count;
    u.torque_nm[kLeg] = s.leg_nm;
  }
};
constexpr LitheLaw kSpoilt = describe<Spoilt>("spoilt");
// What it wants of the leg jumps up and down in every other tick, and of the arm it is PD.
struct ShakesLeg {
  struct Params {};
  struct State {
    double count = 0;
  };
  static void step(const Tick& t, const Params&, State& s, Effort& u) {
    u.torque_nm[kArm] = 4 * (t.setpoint_position_rad[kArm] - t.position_rad[kArm]) - 0.1 * t.velocity_rad_s[kArm];
    s.count += 1;
    u.torque_nm[kLeg] = std::fmod(s.count, 4) < 2 ? 1 : -1;
  }
};
constexpr LitheLaw kShakesLeg = describe<ShakesLeg>("shakes_leg");
struct RunAway {
  struct Params {};
  struct State {};
  static void step(const Tick&, const Params&, State&, Effort& u) { u.torque_nm[kArm] = 1000; }
};
constexpr LitheLaw kRunAway = describe<RunAway>("run_away");

class Groups : public testing::Test, protected TickBench {
 protected:
  explicit Groups(const robot::RobotConfig& robot = two_groups()) : TickBench(robot) {}

  // The leg's drive is as the loop would hear it; whatever leaves stays within the slew bound.
  void live(int count, std::uint32_t leg_status = 0, std::uint32_t without = 0) {
    for (int i = 0; i < count; ++i) {
      const hal::ActuatorCommand before = sent_;
      tick(false);
      if (handover_.pending()) {
        sent_ = handover_.command();
        actuators_->cycle(sent_, handover_.sample(), now_ns_);
        handover_.sample().status[kLeg] = (handover_.sample().status[kLeg] | leg_status) & ~without;
        handover_.finish();
      }
      for (const std::size_t j : {kLeg, kArm})
        EXPECT_LE(std::abs(sent_.torque_nm[j] - before.torque_nm[j]), kSlewPerTickNm + 1e-9) << "joint " << j;
    }
  }
  // A plan for the arm, and a sign of life.
  void move_arm(double goal_rad) {
    wire::Plan plan;
    plan.plan_id = ++plan_id_;
    plan.waypoint_count = 1;
    plan.joint_count = static_cast<std::uint32_t>(robot_.joints.size());
    plan.t_ns[0] = now_ns_ + 300 * kNsPerMs;
    for (std::uint32_t j = 0; j < plan.joint_count; ++j) {
      plan.position_rad[j] = j == kArm ? goal_rad : record_.position_rad[j];
      plan.velocity_rad_s[j] = std::numeric_limits<double>::quiet_NaN();
    }
    ipc::ChannelWriter<wire::Plan>(brain_memory_->plan).write(plan);
    brain_memory_->header.heartbeat_ns = now_ns_;
  }
  std::string last_event(wire::EventKind kind) {
    wire::Event event{};
    std::string text;
    events_.rewind();
    while (events_.next(event))
      if (event.kind == static_cast<std::uint32_t>(kind)) text = event.text.data();
    return text;
  }
  wire::Rung rung(std::size_t j) const { return static_cast<wire::Rung>(record_.joint_rung[j]); }

  ipc::RingReader<wire::Event, wire::spine_segment::kEventsTickDepth> events_{memory_->events_tick};
};

// Its last velocity stays in every sample.
class LostInMotion : public Groups {
 protected:
  void lost(int count) {
    for (int i = 0; i < count; ++i) {
      tick(false);
      actuators_->cycle(handover_.command(), handover_.sample(), now_ns_);
      handover_.sample().status[kLeg] |= wire::joint_status::kLost;
      handover_.sample().velocity_rad_s[kLeg] = 3;
      handover_.finish();
    }
  }
};

TEST_F(LostInMotion, ALegConfirmsNoLaw) {
  arm_with(kBoth);
  lost(100);
  terms_.probation_ticks = 200;
  stage(kBoth);
  lost(400);
  ASSERT_EQ(slot_.active()->law_id, 2u);
  EXPECT_EQ(last_event(wire::EventKind::law_confirmed), "");
  EXPECT_NE(last_event(wire::EventKind::law_unproven), "");
}

TEST_F(LostInMotion, ALegIsNoReasonToBlameTheLawBefore) {
  arm_with(kBoth);
  lost(100);
  terms_.probation_ticks = 200, terms_.probation_error_ratio = 3;
  stage(kBoth);
  lost(400);
  stage(kRunAway);
  for (int i = 0; i < 300 && (i < 2 || slot_.active()->law_id == 3); ++i) lost(1);
  ASSERT_EQ(slot_.active()->law_id, 2u);
  lost(300);
  EXPECT_EQ(slot_.active()->law_id, 2u);
}

TEST_F(Groups, ALegThatIsLostIsTheSafeLawsAndTheArmGoesOn) {
  arm_with(kBoth);
  live(50);
  live(100, wire::joint_status::kLost);
  EXPECT_EQ(mode(), Mode::active);
  EXPECT_EQ(static_cast<wire::Fault>(record_.fault), wire::Fault::drive_lost);
  EXPECT_EQ(rung(kLeg), wire::Rung::safe_law);
  EXPECT_EQ(rung(kArm), wire::Rung::law);
  EXPECT_EQ(static_cast<wire::Fault>(record_.joint_fault[kLeg]), wire::Fault::drive_lost);
  EXPECT_EQ(record_.joint_fault[kArm], 0U);
  EXPECT_NE(record_.flags & wire::telemetry_flag::kGroupStopped, 0U);
  EXPECT_EQ(sent_.kd_nm_s_rad[kLeg], 0.05) << "its drive damps it";
  EXPECT_EQ(last_event(wire::EventKind::group_stopped), "drive_lost at joint shoulder, group leg");
  EXPECT_EQ(last_event(wire::EventKind::safe_stop), "");
  live(50);  // it is heard again: that is no reason to move
  EXPECT_EQ(rung(kLeg), wire::Rung::safe_law);
}

TEST_F(Groups, AResetSwitchesAllOffAndForgets) {
  arm_with(kBoth);
  live(10, wire::joint_status::kLost);
  EXPECT_EQ(send(CommandKind::reset), CommandResult::done);
  tick();
  EXPECT_EQ(mode(), Mode::disarmed);
  EXPECT_EQ(sent_.action[kArm], hal::DriveAction::off);
  EXPECT_EQ(record_.joint_fault[kLeg], 0U);
  ticks(10);
  EXPECT_EQ(send(CommandKind::arm), CommandResult::done);
  ticks(10);
  EXPECT_EQ(rung(kLeg), wire::Rung::law);
}

TEST_F(Groups, TheLastGroupTakesTheRobotWithIt) {
  arm_with(kBoth);
  live(10, wire::joint_status::kLost);
  tick(false);
  handover_.sample().status[kArm] |= wire::joint_status::kFault;
  handover_.finish();
  live(2, wire::joint_status::kLost);
  EXPECT_EQ(mode(), Mode::safe_stop);
  EXPECT_EQ(static_cast<wire::Fault>(record_.fault), wire::Fault::drive_fault) << "what stopped the whole";
  EXPECT_EQ(static_cast<wire::Fault>(record_.joint_fault[kArm]), wire::Fault::drive_fault);
}

// A law that keeps a state of the lost leg, and divides by it.
TEST_F(Groups, WhatALawWantsOfAStoppedLegIsNoReasonToReplaceIt) {
  arm_with(kBoth);
  live(5, wire::joint_status::kLost);
  const std::uint32_t id = stage(kNanLeg).law_id;
  live(5, wire::joint_status::kLost);
  EXPECT_EQ(record_.law_id, id);
  EXPECT_EQ(mode(), Mode::active);
  EXPECT_EQ(rung(kArm), wire::Rung::law);
}

TEST_F(Groups, AStateThatWasSpoiltByAStoppedLegDoesNotDriveItAfterTheReset) {
  arm_with(kSpoilt);
  live(5, wire::joint_status::kLost);
  Spoilt::leg_is_gone = true;
  live(5, wire::joint_status::kLost);
  Spoilt::leg_is_gone = false;
  ASSERT_EQ(mode(), Mode::active) << "nobody looks at the leg";
  EXPECT_EQ(send(CommandKind::reset), CommandResult::done);
  ticks(10);
  EXPECT_EQ(send(CommandKind::arm), CommandResult::done);
  ticks(10);
  EXPECT_EQ(mode(), Mode::active);
  EXPECT_EQ(rung(kLeg), wire::Rung::law);
  EXPECT_EQ(last_event(wire::EventKind::state_not_carried), "leg_nm: no finite number; starts from its default");
  double state[2];
  std::memcpy(state, slot_.active()->state.data(), sizeof state);
  EXPECT_GT(state[1], 20) << "what is sound is kept";
}

// The leg hangs beyond its limits, and a plan for the arm contains that position of the leg.
TEST_F(Groups, WhatAPlanSaysOfAStoppedLegDoesNotKeepTheArmFromFollowingIt) {
  arm_with(kBoth);
  live(10, wire::joint_status::kLost);
  for (const double leg_rad : {10.0, std::nan("")}) {
    wire::Plan plan;
    plan.plan_id = ++plan_id_;
    plan.waypoint_count = 1;
    plan.joint_count = 2;
    plan.t_ns[0] = now_ns_ + 300 * kNsPerMs;
    plan.position_rad[kLeg] = leg_rad;
    plan.position_rad[kArm] = 0.2;
    plan.velocity_rad_s[kLeg] = plan.velocity_rad_s[kArm] = std::numeric_limits<double>::quiet_NaN();
    ipc::ChannelWriter<wire::Plan>(brain_memory_->plan).write(plan);
    brain_memory_->header.heartbeat_ns = now_ns_;
    live(50, wire::joint_status::kLost);
    EXPECT_EQ(last_event(wire::EventKind::plan_refused), "");
    EXPECT_EQ(record_.plan_id, plan_id_);
    EXPECT_GT(record_.setpoint_position_rad[kArm], 0.001);
    EXPECT_EQ(record_.setpoint_position_rad[kLeg], record_.position_rad[kLeg]);
  }
}

TEST_F(Groups, AStoppedJointIsWhereItShallBe) {
  arm_with(kBoth);
  live(300, wire::joint_status::kWatchdog);
  EXPECT_EQ(record_.setpoint_position_rad[kLeg], record_.position_rad[kLeg]);
  EXPECT_EQ(record_.setpoint_velocity_rad_s[kLeg], 0);
}

// The leg has fallen far from where it was to be: that is not the new law's doing.
TEST_F(Groups, ALawOnProbationIsNotBlamedForAStoppedLeg) {
  arm_with(kBoth);
  live(100, wire::joint_status::kLost);
  terms_.probation_ticks = 200;
  terms_.probation_error_ratio = 1.5;
  const std::uint32_t id = stage(kLift).law_id;
  live(250, wire::joint_status::kLost);
  EXPECT_NE(last_event(wire::EventKind::law_unproven), "") << "the arm was not asked to move";
  for (int i = 0; i < 4; ++i) {
    move_arm(i % 2 == 0 ? 0.2 : 0.0);
    live(90, wire::joint_status::kLost);
  }
  EXPECT_EQ(record_.law_id, id);
  EXPECT_EQ(last_event(wire::EventKind::law_rolled_back), "");
  EXPECT_EQ(last_event(wire::EventKind::law_confirmed), "its probation is over, with a part of the robot stopped");
}

TEST_F(Groups, ALawOnProbationIsNotBlamedForWhatItWantsOfAStoppedLeg) {
  arm_with(kBoth);
  live(100, wire::joint_status::kLost);
  terms_.probation_ticks = 200;
  const std::uint32_t id = stage(kShakesLeg).law_id;
  live(250, wire::joint_status::kLost);
  EXPECT_EQ(record_.law_id, id);
  EXPECT_EQ(last_event(wire::EventKind::law_rolled_back), "");
}

// What a law would do with a leg that is the safe law's cannot be compared, and after a reset it would drive it.
TEST_F(Groups, NoLawIsPromotedFromTheShadowWhileAPartIsStopped) {
  arm_with(kBoth);
  terms_.shadow_ticks = 50;
  terms_.shadow_tolerance_nm = 10;
  const std::uint32_t before = record_.law_id;
  stage(kLift);
  live(20);
  live(100, wire::joint_status::kLost);
  EXPECT_EQ(record_.law_id, before) << "it had agreed for 20 ticks";
  EXPECT_EQ(last_event(wire::EventKind::shadow_ended), "a part of the robot is stopped: nothing can be compared there");
  stage(kLift);
  live(100, wire::joint_status::kLost);
  EXPECT_EQ(record_.law_id, before);
}

// Of this robot the guard does not know how its joints can be stopped: a law can leave the limits.
robot::RobotConfig undeclared() {
  robot::RobotConfig robot = two_groups();
  for (robot::JointConfig& joint : robot.joints) joint.inertia_max_kg_m2 = 0;
  return robot;
}
struct UndeclaredGroups : Groups {
  UndeclaredGroups() : Groups(undeclared()) {}
};

// It drives the arm over its speed limit, while the leg is long lost: it must not be there after the reset.
TEST_F(UndeclaredGroups, ALawOnProbationThatRunsAwayWithTheLastGroupIsRolledBack) {
  arm_with(kBoth);
  const std::uint32_t before = record_.law_id;
  live(10, wire::joint_status::kLost);
  terms_.probation_ticks = 500;
  stage(kRunAway);
  live(400, wire::joint_status::kLost);
  EXPECT_EQ(mode(), Mode::safe_stop);
  EXPECT_EQ(static_cast<wire::Fault>(record_.fault), wire::Fault::position_limit);
  EXPECT_EQ(slot_.active()->law_id, before);
}

// The converse: a joint that sags past its limit when all is stopped is no law's doing.
TEST_F(Groups, ALawOnProbationIsNotBlamedForWhatFallsInTheSafeStop) {
  arm_with(kBoth);
  terms_.probation_ticks = 5000;
  const std::uint32_t id = stage(kLift).law_id;
  live(20);
  const auto with = [&](std::uint32_t status, double velocity_rad_s) {
    tick(false);
    actuators_->cycle(handover_.command(), handover_.sample(), now_ns_);
    for (const std::size_t j : {kLeg, kArm}) handover_.sample().status[j] |= status;
    handover_.sample().velocity_rad_s[kArm] += velocity_rad_s;
    handover_.finish();
  };
  for (int i = 0; i < 5; ++i) with(wire::joint_status::kWatchdog, 0);
  ASSERT_EQ(mode(), Mode::safe_stop);
  for (int i = 0; i < 5; ++i) with(0, 1000);
  EXPECT_EQ(slot_.active()->law_id, id);
}

TEST_F(Groups, HeldItIsArmedAgainWithoutThePartThatIsStopped) {
  arm_with(kBoth);
  live(10, wire::joint_status::kLost, wire::joint_status::kFresh);
  EXPECT_EQ(send(CommandKind::hold), CommandResult::done);
  live(2, wire::joint_status::kLost, wire::joint_status::kFresh);
  wire::Command arm;
  arm.kind = static_cast<std::uint32_t>(CommandKind::arm);
  const auto ticket = command_->send(arm);
  live(2, wire::joint_status::kLost, wire::joint_status::kFresh);
  EXPECT_EQ(static_cast<CommandResult>(command_->poll(*ticket)), CommandResult::done);
  EXPECT_EQ(mode(), Mode::active);
}

// People are at the leg when somebody presses the button because of the arm.
TEST_F(Groups, AnEstopDoesNotSwitchOnWhatTheLadderHadSwitchedOff) {
  arm_with(kBoth);
  live(1500, wire::joint_status::kFault);
  ASSERT_EQ(rung(kLeg), wire::Rung::off);
  ASSERT_EQ(rung(kArm), wire::Rung::law);
  ASSERT_EQ(send(CommandKind::estop), CommandResult::done);
  live(3);
  EXPECT_EQ(sent_.action[kLeg], hal::DriveAction::off);
  EXPECT_EQ(sent_.action[kArm], hal::DriveAction::damp);
  EXPECT_EQ(rung(kLeg), wire::Rung::off);
}

}  // namespace
}  // namespace lithe::loop
