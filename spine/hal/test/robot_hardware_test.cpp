// SPDX-License-Identifier: Apache-2.0
// The whole stack as the loop sees it: joint commands in, joint states out, real frames in between.
#include "spine/hal/robot_hardware.hpp"
#include "spine/core/test/units_rig.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "spine/core/test/no_alloc_rig.hpp"
#include "spine/hal/bus/test/pty_rig.hpp"
#include "spine/hal/sim/simulate.hpp"
#include "spine/robot/robot.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::hal {
namespace {

constexpr std::int64_t kTickNs = 1'000'000;

robot::RobotConfig desk_arm() {
  Result<robot::RobotConfig> config = robot::load_robot(LITHE_ROBOTS "/arm.toml");
  EXPECT_TRUE(config) << (config ? "" : config.message());
  config->plant.ideal = true;  // what is tested here is the way there and back
  return *config;
}

std::uint32_t mode_of(const ActuatorState& state, std::size_t joint = 0) { return (state.status[joint] >> 16) & 0xff; }
std::uint32_t fault_of(const ActuatorState& state, std::size_t joint = 0) { return (state.status[joint] >> 8) & 0xff; }

// One tick at a time, on a clock that only cycle() turns.
class Robot {
 public:
  explicit Robot(const robot::RobotConfig& config) {
    Result<std::unique_ptr<Actuators>> opened = sim::open_actuators(config);
    EXPECT_TRUE(opened) << (opened ? "" : opened.message());
    actuators_ = std::move(*opened);
    command.joints = static_cast<std::uint32_t>(config.joints.size());
    for (std::size_t i = 0; i < config.joints.size(); ++i) {
      command.position_rad[i] = kNan;
      command.max_torque_nm[i] = config.joints[i].torque_max_nm;
    }
  }

  void cycle(int times = 1) {
    for (int i = 0; i < times; ++i) {
      ++command.tick;
      actuators_->cycle(command, state, now_ns);
      now_ns += kTickNs;
    }
  }

  const ReplyCounters& counters() const { return actuators_->counters(); }
  const Actuators& hardware() const { return *actuators_; }

  // Off until the drives have said how they are set, then torque until they have calibrated.
  void arm() {
    command.act(DriveAction::off);
    cycle(20);
    command.act(DriveAction::torque);
    cycle(10);
    ASSERT_EQ(mode_of(state), 10U);
  }

  ActuatorCommand command;
  ActuatorState state;
  std::int64_t now_ns = 5'000'000'000;

 private:
  std::unique_ptr<Actuators> actuators_;
};

TEST(Actuators, TheFirstCycleTellsWhereTheArmIs) {
  robot::RobotConfig config = desk_arm();
  config.joints[0].sim.initial_position_rad = 0.05;
  Robot robot(config);
  robot.cycle();
  EXPECT_EQ(robot.state.tick, 1U);
  EXPECT_EQ(robot.state.joints, 1U);
  EXPECT_EQ(robot.state.sample_ns, 5'000'000'000);
  EXPECT_NEAR(robot.state.position_rad[0], 0.05, 4e-4);
  EXPECT_EQ(robot.state.status[0], wire::joint_status::kFresh | wire::joint_status::kNotReady);
  robot.cycle(60);
  EXPECT_EQ(robot.state.status[0], wire::joint_status::kFresh) << "the drive has said how it is set";
  EXPECT_EQ(robot.counters().missed, 0U);
}

TEST(Actuators, EveryActionPutsTheDriveIntoItsMode) {
  Robot robot(desk_arm());
  robot.arm();
  robot.command.act(DriveAction::damp);
  robot.cycle(2);
  EXPECT_EQ(mode_of(robot.state), 12U);
  robot.command.act(DriveAction::brake);
  robot.cycle(2);
  EXPECT_EQ(mode_of(robot.state), 15U);
  robot.command.act(DriveAction::off);
  robot.cycle(2);
  EXPECT_EQ(mode_of(robot.state), 0U);
}

// Whatever was commanded while it calibrated.
TEST(Actuators, TheFirstTorqueOfADriveIsNoStep) {
  const robot::RobotConfig config = desk_arm();
  Robot robot(config);
  robot.cycle(20);
  robot.command.act(DriveAction::torque);
  robot.command.torque_nm[0] = 0.5;
  double before_nm = 0;
  for (int i = 0; i < 30; ++i) {
    robot.cycle();
    ASSERT_LE(robot.state.torque_nm[0] - before_nm, config.joints[0].torque_slew_nm_s * 1e-3 + 1e-3) << i;
    before_nm = robot.state.torque_nm[0];
  }
  EXPECT_NEAR(before_nm, 0.5, 0.05) << "all of it, in the end";
}

TEST(Actuators, AConstantTorqueDeflectsTheArmToTheArcSineWithinItsFriction) {
  const robot::RobotConfig config = desk_arm();
  Robot robot(config);
  robot.arm();
  for (const double torque_nm : {0.06, 0.1}) {
    robot.command.torque_nm[0] = torque_nm;
    robot.command.kd_nm_s_rad[0] = 0.01;  // the drive's own damping, so that it comes to rest sooner
    robot.cycle(8000);
    const double balance = torque_nm - config.joints[0].sim.mgl_nm * std::sin(robot.state.position_rad[0]);
    EXPECT_LE(std::abs(balance), config.joints[0].sim.coulomb_nm + 2e-4);
    EXPECT_NEAR(robot.state.torque_nm[0], torque_nm, 1e-3);
    EXPECT_EQ(robot.state.velocity_rad_s[0], 0.0);
  }
}

double tracking_rmse_rad(Robot& robot, bool in_the_drive) {
  double sum = 0;
  constexpr int kTicks = 4000;
  for (int i = 0; i < kTicks; ++i) {
    const double phase = 2 * std::numbers::pi * 0.5 * i * 1e-3;
    const double wanted_rad = 0.8 * std::sin(phase);
    const double wanted_rad_s = 0.8 * 2 * std::numbers::pi * 0.5 * std::cos(phase);
    const double error_rad = wanted_rad - robot.state.position_rad[0];
    if (in_the_drive) {
      robot.command.position_rad[0] = wanted_rad;
      robot.command.velocity_rad_s[0] = wanted_rad_s;
      robot.command.kp_nm_rad[0] = 5;
      robot.command.kd_nm_s_rad[0] = 0.1;
    } else {
      robot.command.torque_nm[0] = 5 * error_rad + 0.1 * (wanted_rad_s - robot.state.velocity_rad_s[0]);
    }
    robot.cycle();
    sum += error_rad * error_rad;
  }
  return std::sqrt(sum / kTicks);
}

TEST(Actuators, APdLawTracksASineThroughRealFrames) {
  Robot robot(desk_arm());
  robot.arm();
  EXPECT_LT(tracking_rmse_rad(robot, false), 0.04);
  EXPECT_EQ(robot.counters().missed, 0U);
}

TEST(Actuators, TheDrivesOwnPdTracksASineThroughRealFrames) {
  Robot robot(desk_arm());
  robot.arm();
  EXPECT_LT(tracking_rmse_rad(robot, true), 0.04);
}

TEST(Actuators, SignZeroAndRatioChangeNothingThatTheLoopSees) {
  robot::RobotConfig plain = desk_arm();
  // The drive's own damping, between the ticks, would feel the steps of an encoder that a gear makes finer.
  plain.joints[0].safe_kd_nm_s_rad = 1e-9;
  robot::RobotConfig geared = plain;
  geared.joints[0].sign = -1;
  geared.joints[0].zero_rad = 1.25;
  geared.joints[0].ratio = 6;
  Robot a(plain);
  Robot b(geared);
  a.arm();
  b.arm();
  for (int i = 0; i < 1000; ++i) {
    a.command.torque_nm[0] = b.command.torque_nm[0] = 0.1 * std::sin(0.01 * i);
    a.cycle();
    b.cycle();
    ASSERT_NEAR(a.state.position_rad[0], b.state.position_rad[0], 2e-3) << i;
    ASSERT_NEAR(a.state.torque_nm[0], b.state.torque_nm[0], 1e-4) << i;
  }
}

TEST(Actuators, ASpineThatStallsFindsItsDrivesInTimeoutUntilItStopsThem) {
  Robot robot(desk_arm());
  robot.arm();
  robot.now_ns += 250'000'000;  // the arm's watchdog is 200 ms
  robot.cycle();
  EXPECT_EQ(robot.state.status[0] & 0xff, wire::joint_status::kFresh | wire::joint_status::kWatchdog);
  robot.cycle(50);
  EXPECT_EQ(mode_of(robot.state), 11U);
  robot.arm();
  EXPECT_EQ(fault_of(robot.state), 0U);
}

TEST(Actuators, ATorqueThatIsNotANumberDampsTheJoint) {
  Robot robot(desk_arm());
  robot.arm();
  robot.command.torque_nm[0] = kNan;
  robot.cycle(2);
  EXPECT_EQ(mode_of(robot.state), 12U);
  EXPECT_TRUE(std::isfinite(robot.state.position_rad[0]));
}

TEST(Actuators, ACycleAllocatesNothing) {
  robot::RobotConfig config = desk_arm();
  Robot robot(config);
  robot.cycle();
  const NoAllocScope scope;
  for (const DriveAction action : {DriveAction::off, DriveAction::torque, DriveAction::damp, DriveAction::brake}) {
    robot.command.act(action);
    robot.cycle(20);
  }
}

TEST(Actuators, AsManyJointsAsFitAreServedOnOneBusEachByItsOwnDrive) {
  robot::RobotConfig config = desk_arm();
  config.joints.resize(kMaxJoints, config.joints[0]);
  config.devices.resize(kMaxJoints, config.devices[0]);
  for (std::size_t i = 0; i < kMaxJoints; ++i) {
    config.joints[i].device = i;
    config.joints[i].sim.mgl_nm = 0;
    config.joints[i].sim.initial_position_rad = 0.01 * static_cast<double>(i);
    config.devices[i].id = static_cast<std::uint32_t>(i + 1);
  }
  Robot robot(config);
  robot.cycle(60);
  EXPECT_EQ(robot.counters().missed, 0U);
  for (std::size_t i = 0; i < kMaxJoints; ++i) {
    EXPECT_NEAR(robot.state.position_rad[i], 0.01 * static_cast<double>(i), 4e-4);
    EXPECT_EQ(robot.state.status[i], wire::joint_status::kFresh);
  }
}

TEST(Actuators, JointsBeyondTheCommandAreOff) {
  Robot robot(desk_arm());
  robot.arm();
  robot.command.joints = 0;
  robot.cycle(2);
  EXPECT_EQ(mode_of(robot.state), 0U);
}

TEST(Actuators, AProgramWithoutSimulatedDevicesRefusesASimulatedBus) {
  EXPECT_NE(open_actuators(desk_arm()).message().find("bus 'can0' is simulated"), std::string::npos);
}

TEST(Actuators, WhatARealBusSaidOtherwiseThanAskedIsTold) {
  test::TestPty pty;
  robot::RobotConfig config = desk_arm();
  config.buses[0].kind = robot::BusKind::fdcanusb;
  config.buses[0].path = pty.path();
  config.buses[0].keys.fdcanusb.checksums = Checksums::off;
  config.buses[0].reply_wait_s = 0;
  Robot robot(config);
  EXPECT_EQ(robot.hardware().tell_buses(), "");
  pty.say("rcv 0100 012 E B F r x00\r\nERR bad id\r\n");
  ASSERT_TRUE(test::await([&] {
    robot.cycle(1);
    return robot.hardware().tell_buses().find("1 malformed, 1 errors") != std::string::npos;
  }));
  EXPECT_TRUE(robot.hardware().tell_buses().starts_with("bus '" + config.buses[0].name + "': "));
}

}  // namespace
}  // namespace lithe::hal
