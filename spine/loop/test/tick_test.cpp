// SPDX-License-Identifier: Apache-2.0
#include <gtest/gtest.h>

#include <cmath>
#include <string>

#include "spine/core/test/no_alloc_rig.hpp"
#include "spine/loop/test/tick_rig.hpp"

namespace lithe::loop {
namespace {

class SoftRig : public TickBench {
 public:
  using TickBench::stage;
  using TickBench::TickBench;

  void arm_with(const LitheLaw& law) {
    stage(law);
    ticks(3);
    ASSERT_EQ(send(CommandKind::arm), CommandResult::done);
    soft_ = is_soft() ? 1 : 0;
  }
  // How many of these ticks start softly. What a drive may give, and what the law gives, grow by `step_nm` a tick.
  int soft_ticks(int count, double step_nm) {
    int soft = 0;
    for (int i = 0; i < count; ++i) {
      tick();
      soft += is_soft() ? 1 : 0;
      if (!is_soft()) continue;
      ++soft_;
      EXPECT_LE(std::abs(record_.command_torque_nm[0]), soft_ * step_nm + 1e-9) << soft_;
      EXPECT_LE(sent_.max_torque_nm[0], soft_ * step_nm + 1e-9) << soft_;
    }
    return soft;
  }

 private:
  bool is_soft() const { return (record_.flags & wire::telemetry_flag::kSoftStarting) != 0; }
  int soft_ = 0;
};

TEST_F(TickTest, DrivesAreOffUntilSomebodyArms) {
  stage(kPd);
  ticks(20);
  EXPECT_EQ(mode(), Mode::disarmed);
  EXPECT_EQ(sent_.action[0], hal::DriveAction::off);
  EXPECT_EQ(record_.joint_status[0] >> 16, 0u) << "the drive itself says: stopped";
}

TEST_F(TickTest, AnArmedLawTracksThePlan) {
  arm_with(kPd);
  publish(0.5);
  for (int i = 0; i < 600; ++i) {
    brain_memory_->header.heartbeat_ns = now_ns_;
    tick();
  }
  EXPECT_EQ(mode(), Mode::active);
  EXPECT_EQ(record_.plan_id, 1u);
  EXPECT_NEAR(record_.setpoint_position_rad[0], 0.5, 1e-9);
  EXPECT_NEAR(record_.position_rad[0], 0.5, 0.05);
}

TEST_F(TickTest, WhatTheLawWantsAndWhatItTracksArePublished) {
  arm_with(kPd);
  publish(0.5);
  double velocity_rad_s = 0, difference_nm = 0;
  while (record_.setpoint_velocity_rad_s[0] < 0.1) tick();
  const double from_rad_s = record_.setpoint_velocity_rad_s[0];
  for (int i = 0; i < 100; ++i) {
    tick();
    velocity_rad_s += record_.setpoint_acceleration_rad_s2[0] * 1e-3;
    difference_nm = std::max(difference_nm, std::abs(record_.law_torque_nm[0] - record_.command_torque_nm[0]));
  }
  EXPECT_GT(velocity_rad_s, 0.1);
  EXPECT_NEAR(velocity_rad_s, record_.setpoint_velocity_rad_s[0] - from_rad_s, 0.03 * velocity_rad_s);
  EXPECT_LT(difference_nm, 1e-9) << "the guard takes nothing from a law that stays inside";
  stage(kPush);
  ticks(3);
  EXPECT_EQ(record_.law_torque_nm[0], -1000.0);
  EXPECT_LE(std::abs(record_.command_torque_nm[0]), 0.6);
}

TEST_F(TickTest, WhatDrivesTellOfThemselvesIsPublished) {
  arm_with(kPd);
  ticks(100);
  EXPECT_EQ(record_.drive_state[0], static_cast<std::uint32_t>(wire::DriveState::driven));
  EXPECT_DOUBLE_EQ(record_.drive_voltage_v[0], 24);
  EXPECT_DOUBLE_EQ(record_.drive_temperature_degc[0], 25);
  EXPECT_TRUE(std::isnan(record_.drive_current_a[0])) << "not asked for in the robot file";
}

TEST_F(TickTest, TheCommandOfATickLeavesAtTheNextRelease) {
  arm_with(kPush);
  const std::uint64_t computed_in = record_.tick;
  const double torque_nm = record_.command_torque_nm[0];
  tick();
  EXPECT_EQ(sent_.tick, computed_in + 1);
  EXPECT_DOUBLE_EQ(sent_.torque_nm[0], torque_nm);
}

TEST_F(TickTest, NoSwapEverMovesTheTorqueFasterThanTheSlewBound) {
  arm_with(kPd);
  double last_nm = record_.command_torque_nm[0];
  for (int i = 0; i < 400; ++i) {
    if (i % 5 == 0) stage(i % 10 == 0 ? kPush : kPd);
    tick();
    ASSERT_EQ(mode() == Mode::active || mode() == Mode::safe_stop, true);
    ASSERT_LE(std::abs(record_.command_torque_nm[0] - last_nm), kSlewPerTickNm + 1e-9) << "tick " << i;
    last_nm = record_.command_torque_nm[0];
  }
}

TEST_F(TickTest, StateIsCarriedIntoTheNextLawByName) {
  arm_with(kPd);
  publish(0.5);
  ticks(50);
  const double before = reinterpret_cast<const Pd::State*>(slot_.active()->state.data())->integral_rad_s;
  ASSERT_NE(before, 0.0);
  stage(kPush);
  tick();
  const double after = reinterpret_cast<const Push::State*>(slot_.active()->state.data())->integral_rad_s;
  EXPECT_NE(after, 1.0) << "the default of the new law would be 1.0";
  EXPECT_NEAR(after, before, 0.01);
}

TEST_F(TickTest, RollbackBringsThePreviousLawBack) {
  arm_with(kPd);
  stage(kPush);
  ticks(2);
  EXPECT_EQ(send(CommandKind::rollback), CommandResult::done);
  tick();
  EXPECT_EQ(record_.law_id, 1u);
  EXPECT_EQ(send(CommandKind::rollback), CommandResult::refused_law) << "there is no law before the first";
}

TEST_F(TickTest, ParametersChangeAllOrNone) {
  arm_with(kPd);
  wire::Command command;
  command.kind = static_cast<std::uint32_t>(CommandKind::set_params);
  command.count = 2;
  command.index = {0, 1};
  command.value[0] = 8.0;
  command.value[1] = 99.0;  // above its maximum
  EXPECT_EQ(send(command), CommandResult::refused_range);
  EXPECT_EQ(slot_.active()->params[0].value, 4.0);
  command.value[1] = 0.3;
  EXPECT_EQ(send(command), CommandResult::done);
  EXPECT_EQ(slot_.active()->params[0].value, 8.0);
  EXPECT_EQ(slot_.active()->params[1].value, 0.3);
}

TEST_F(TickTest, ALateTransportIsCountedAndStopsTheRobotWhenItStaysLate) {
  arm_with(kPd);
  const std::uint32_t before = record_.late_samples;
  for (int i = 0; i < 3; ++i) tick(false);  // the first of these still finds the exchange before done
  EXPECT_EQ(record_.late_samples, before + 2);
  EXPECT_EQ(mode(), Mode::active);
  serve();
  ticks(3);
  EXPECT_EQ(mode(), Mode::active) << "a short delay is survived";
  for (int i = 0; i < 8; ++i) tick(false);
  EXPECT_EQ(mode(), Mode::safe_stop);
  EXPECT_EQ(static_cast<wire::Fault>(record_.fault), wire::Fault::sample_stale);
}

TEST_F(TickTest, ALateBusNeverMakesTheTorqueStepBeyondTheSlewBound) {
  arm_with(kPd);
  double left_nm = sent_.torque_nm[0];
  for (int i = 0; i < 300; ++i) {
    if (i % 20 == 0) stage(i % 40 == 0 ? kPush : kPd);
    tick(i % 4 != 0);  // a bus that is late for one tick in four
    ASSERT_EQ(mode(), Mode::active);
    ASSERT_LE(std::abs(sent_.torque_nm[0] - left_nm), kSlewPerTickNm + 1e-9) << "tick " << i;
    left_nm = sent_.torque_nm[0];
  }
}

// Of the drive's own mode: what the last rungs are is for it to know.
TEST_F(TickTest, TheRungsBelowTheSafeLawReachTheDrive) {
  robot_.guard.brake_after_s = 0.05;
  robot_.guard.off_after_s = 0.2;
  use_cell(nullptr);
  arm_with(kPd);
  const auto drive_mode = [this] { return record_.joint_status[0] >> 16 & 0xff; };
  EXPECT_EQ(drive_mode(), 10U);
  for (int i = 0; i < 8; ++i) tick(false);  // the bus is late, which is a fault
  serve();
  ticks(45);
  EXPECT_EQ(mode(), Mode::safe_stop);
  EXPECT_EQ(drive_mode(), 10U) << "the safe law";
  ticks(50);
  EXPECT_EQ(drive_mode(), 15U) << "braked";
  ticks(300);
  EXPECT_EQ(drive_mode(), 0U) << "off";
}

TEST_F(TickTest, ADriveThatHasNotSaidHowItIsSetIsNotArmed) {
  actuators_ = std::move(*hal::sim::open_actuators(robot_));
  stage(kPd);
  ticks(3);
  EXPECT_EQ(send(CommandKind::arm), CommandResult::refused_not_ready);
  ticks(20);
  EXPECT_EQ(send(CommandKind::arm), CommandResult::done);
}

TEST_F(TickTest, ADriveThatReportsAFaultIsNotArmedAndAResetReachesIt) {
  stage(kPd);
  ticks(3);
  const auto says = [this](std::uint32_t bits) {
    tick(false);
    handover_.sample().status[0] |= bits;
    handover_.finish();
  };
  for (const std::uint32_t bits : {wire::joint_status::kFault, wire::joint_status::kWatchdog}) {
    tick();
    EXPECT_EQ(send(CommandKind::reset), CommandResult::refused_mode);
    says(bits);
    EXPECT_EQ(send(CommandKind::arm), CommandResult::refused_not_ready);
    EXPECT_EQ(mode(), Mode::disarmed);
    says(bits);
    EXPECT_EQ(send(CommandKind::reset), CommandResult::done);
    tick();
    EXPECT_TRUE(sent_.clear_faults);
  }
  EXPECT_EQ(send(CommandKind::arm), CommandResult::done);
}

TEST_F(TickTest, AnEstopLeavesLimpDrivesOffAndDampsTheOthers) {
  stage(kPd);
  ticks(3);
  control_memory_->estop.value = 1;
  ticks(20);
  EXPECT_EQ(mode(), Mode::estop);
  EXPECT_EQ(record_.joint_status[0] >> 16 & 0xff, 0U) << "nobody gave it torque";
  control_memory_->estop.value = 0;
  EXPECT_EQ(send(CommandKind::reset), CommandResult::done);
  EXPECT_EQ(send(CommandKind::arm), CommandResult::done);
  ticks(10);
  control_memory_->estop.value = 1;
  ticks(6);
  EXPECT_EQ(record_.joint_status[0] >> 16 & 0xff, 12U);
}

TEST_F(TickTest, AJointWhoseSampleIsLostIsDampedByItsDrive) {
  arm_with(kPd);
  publish(1.3);
  for (int i = 0; i < 400; ++i) {
    brain_memory_->header.heartbeat_ns = now_ns_;
    tick();
  }
  double speed_rad_s = 0;
  for (int i = 0; i < 150; ++i) {  // its answers come, but none that the guard may act upon
    tick(false);
    sent_ = handover_.command();
    actuators_->cycle(sent_, handover_.sample(), now_ns_);
    speed_rad_s = handover_.sample().velocity_rad_s[0];
    handover_.sample().status[0] |= wire::joint_status::kLost;
    handover_.finish();
  }
  EXPECT_EQ(mode(), Mode::safe_stop);
  EXPECT_EQ(sent_.torque_nm[0], 0.0);
  EXPECT_EQ(sent_.kd_nm_s_rad[0], 0.05);
  EXPECT_LT(std::abs(speed_rad_s), 4.0) << "falling free it would do 8 rad/s";
}

TEST_F(TickTest, SkippedReleasesAreCounted) {
  arm_with(kPd);
  tick(true, 3);
  EXPECT_EQ(record_.missed_releases, 3u);
  EXPECT_NE(record_.flags & wire::telemetry_flag::kDeadlineMissed, 0u);
  // On a busy machine a tick of this test may miss its deadline itself.
  for (int i = 0; i < 100 && (record_.flags & wire::telemetry_flag::kDeadlineMissed) != 0; ++i) tick();
  EXPECT_EQ(record_.flags & wire::telemetry_flag::kDeadlineMissed, 0u);
}

// The same robot, whose file calls a missed deadline a fault. Its ticks are long, so that none of this test misses its
// own.
class MissedDeadlineTest : public testing::Test, protected TickBench {
 protected:
  MissedDeadlineTest() : TickBench(robot_that_stops()) {}

  static robot::RobotConfig robot_that_stops() {
    robot::RobotConfig robot = *robot::parse_robot(kRobot, "probe.toml");
    robot.rate_hz = 100;
    robot.spine.miss_policy = robot::MissPolicy::stop;
    return robot;
  }
};

TEST_F(MissedDeadlineTest, StopsTheRobotInTheTickThatSawIt) {
  arm_with(kPd);
  ASSERT_EQ(mode(), Mode::active);
  tick(true, 1);
  EXPECT_EQ(mode(), Mode::safe_stop);
  EXPECT_EQ(static_cast<wire::Fault>(record_.fault), wire::Fault::deadline_missed);
}

TEST_F(TickTest, EitherEstopWordStopsTheDrivesAndStaysUntilReleasedAndReset) {
  for (std::uint64_t* word : {&control_memory_->estop.value, &brain_memory_->estop.value}) {
    if (mode() != Mode::active) arm_with(kPd);
    *word = 1;
    ticks(2);
    EXPECT_EQ(mode(), Mode::estop);
    EXPECT_EQ(sent_.action[0], hal::DriveAction::damp);
    EXPECT_EQ(send(CommandKind::reset), CommandResult::refused_estop);
    *word = 0;
    ticks(5);
    EXPECT_EQ(mode(), Mode::estop) << "letting go is not a reset";
    EXPECT_EQ(send(CommandKind::reset), CommandResult::done);
    EXPECT_EQ(mode(), Mode::disarmed);
  }
}

TEST_F(TickTest, ASilentBrainLeavesTheJointAtRestWhereItIs) {
  arm_with(kPd);
  publish(1.5, 5000);
  ticks(300);  // in full flight; nothing more ever comes from the Brain
  EXPECT_NE(record_.flags & wire::telemetry_flag::kBrainStale, 0u);
  ticks(200);
  const double rest_rad = record_.setpoint_position_rad[0];
  EXPECT_EQ(record_.setpoint_velocity_rad_s[0], 0.0);
  EXPECT_LT(rest_rad, 0.5) << "the plan goes on for seconds: it is not followed to its end";
  ticks(1000);
  EXPECT_EQ(mode(), Mode::active);
  EXPECT_EQ(record_.setpoint_position_rad[0], rest_rad);
}

// What a law is told on its first ticks, whatever the release jitter was.
struct Watch {
  struct Params {};
  struct State {};
  struct Probes {
    double t_s = 0, brain_age_s = 0;
  };
  static void step(const Tick& t, const Params&, State&, Effort&, Probes& p) {
    p.t_s = t.t_s;
    p.brain_age_s = t.brain_age_s;
  }
};
constexpr LitheLaw kWatch = describe<Watch>("watch");

TEST_F(TickTest, ALawsTimeBeginsAtZeroAndItsProbesLeaveWithIt) {
  arm_with(kPd);
  stage(kWatch);
  spine_->tick(now_ns_ + kNsPerMs, now_ns_ + kNsPerMs + 900'000, 0);  // commits late in its period
  now_ns_ += kNsPerMs;
  serve();
  tick();
  EXPECT_EQ(record_.probe[0], 0.0);
  EXPECT_TRUE(std::isinf(record_.probe[1])) << "no Brain was ever there";
  tick();
  EXPECT_NEAR(record_.probe[0], 1e-3, 1e-9);
  stage(kPd);
  ticks(2);
  EXPECT_EQ(record_.probe[1], 0.0);
}

// The default is also in docs/hardware.md; tests/system/laws/test_limits.py compares them.
TEST(SoftStart, ARobotFileWithoutTheKeyHasHalfASecondOfIt) {
  for (const int rate_hz : {250, 1000}) {
    std::string text = kRobot;
    text.replace(text.find("soft_start_s = 0.0"), 18, "");
    text.replace(text.find("rate_hz = 1000"), 14, "rate_hz = " + std::to_string(rate_hz));
    const auto robot = robot::parse_robot(text, "probe.toml");
    ASSERT_TRUE(robot) << robot.message();
    SoftRig rig(*robot);
    rig.arm_with(kPush);
    const int all = rate_hz / 2;
    EXPECT_EQ(rig.soft_ticks(all / 4, 0.6 / all), all / 4) << "a quarter of it: the law pushes with a quarter at most";
    rig.stage(kPd);
    EXPECT_NEAR(rig.soft_ticks(2 * all, 0.6 / all), all - all / 4, 2) << rate_hz;
  }
}

TEST_F(TickTest, AReleaseNobodyServedCountsAsLate) {
  arm_with(kPd);
  const std::uint64_t before = memory_->release_jitter.count;
  tick(true, 3);
  EXPECT_EQ(memory_->release_jitter.count, before + 4);
  EXPECT_EQ(memory_->release_jitter.max_ns, 3 * kNsPerMs + 100u);
}

TEST_F(TickTest, NothingIsAllocatedWhateverHappens) {
  arm_with(kPd);
  const NoAllocScope scope;
  for (int i = 0; i < 1000; ++i) {
    if (i % 100 == 0) publish(i % 200 == 0 ? 0.4 : -0.4);
    if (i == 300) stage(kPush);
    if (i == 400) send(CommandKind::rollback);
    if (i == 500) control_memory_->estop.value = 1;
    tick(i % 97 != 0, i % 89 == 0 ? 2 : 0);
    serve();
  }
}

}  // namespace
}  // namespace lithe::loop
