// SPDX-License-Identifier: Apache-2.0
// No motor starts by itself, and none keeps a torque that nobody asks for any more.
#include <algorithm>
#include <array>
#include <cmath>
#include <string>
#include <utility>

#include "spine/hal/cia402/test/cia402_line_rig.hpp"

namespace lithe::hal {
namespace {

using cia402::Mode;
using cia402::State;
using wire::joint_status::kFault;

class Cia402Safety : public Cia402Line {
 protected:
  // As the guard brakes a joint of which it knows nothing: it relies on the drive's own damping.
  void brake_blindly() {
    command_.torque_nm[0] = 0;
    command_.position_rad[0] = kNan;
    command_.velocity_rad_s[0] = 0;
    command_.kp_nm_rad[0] = 0;
    command_.kd_nm_s_rad[0] = 0.5;
  }
  void accelerate() {
    command_.torque_nm[0] = command_.kd_nm_s_rad[0] = 0;
    enable();
    command_.torque_nm[0] = 1;
    cycle(300);
    ASSERT_GT(plant().velocity_rad_s(), 4);
  }
  double slowest(int cycles) {
    double least = plant().velocity_rad_s();
    for (int i = 0; i < cycles; ++i) {
      cycle();
      least = std::min(least, plant().velocity_rad_s());
    }
    return least;
  }
  void tell_network(canopen::NmtCommand command) {
    FrameQueue unheard;
    drive().on_frame(canopen::nmt_frame(command, 1), now_ns_, unheard);
  }
  void expect_off_until_it_is_switched_off_and_on() {
    cycle(1000);
    EXPECT_NE(drive_state(), State::operation_enabled);
    EXPECT_NEAR(plant().torque_nm(), 0, 1e-6);
    EXPECT_TRUE(has(kFault));
    EXPECT_NE(drivers_[0]->why_not_ready(), "");
    act(DriveAction::off, 2);
    EXPECT_FALSE(has(kFault));
    EXPECT_EQ(drivers_[0]->why_not_ready(), "");
    act(DriveAction::torque, 10);
    EXPECT_EQ(drive_state(), State::operation_enabled);
    EXPECT_FALSE(has(kFault));
  }
};

TEST_F(Cia402Safety, BlindBrakingNeverTurnsAJointRound) {
  for (const std::uint32_t lost : {0x281U, 0x181U}) {
    if (bus_ == nullptr) build();
    accelerate();
    cables_[0]->back = [lost](Frame& frame) { return frame.id != lost; };
    cycle(6);  // a velocity may stand in for the next ones
    ASSERT_TRUE(has(wire::joint_status::kLost));
    brake_blindly();
    EXPECT_GT(slowest(2000), -0.3) << std::hex << lost;
    EXPECT_LT(plant().velocity_rad_s(), 0.3);
    cables_[0]->back = [](Frame&) { return true; };
    expect_off_until_it_is_switched_off_and_on();
  }
}

TEST_F(Cia402Safety, AMotorWhoseTorqueWasTakenAwayDoesNotStartWhenItIsGivenBack) {
  build();
  enable();
  command_.torque_nm[0] = 0.5;
  cycle(50);
  drive().servo().set_torque_off(true);
  cycle(2);
  EXPECT_TRUE(has(kFault));
  EXPECT_EQ(fault_class(), 0xffU);
  EXPECT_NE(drivers_[0]->why_not_ready().find("switch on disabled"), std::string::npos) << drivers_[0]->why_not_ready();
  cycle(100);
  drive().servo().set_torque_off(false);
  expect_off_until_it_is_switched_off_and_on();
}

TEST_F(Cia402Safety, WhatStoppedAtALimitSwitchStopsOnItsOwnRampAndStays) {
  build();
  accelerate();
  command_.torque_nm[0] = 0.5;
  drive().servo().stop_at_limit();
  cycle(20);
  EXPECT_TRUE(has(kFault));
  EXPECT_EQ(drive().servo().state(), State::quick_stop_active) << "its ramp was cut";
  expect_off_until_it_is_switched_off_and_on();
}

TEST_F(Cia402Safety, ADriveThatStopsFollowingItsTargetIsAFault) {
  build();
  enable();
  drive().servo().ignore_target(true);
  cycle(2);
  EXPECT_TRUE(has(kFault));
  drive().servo().ignore_target(false);
  expect_off_until_it_is_switched_off_and_on();
}

TEST_F(Cia402Safety, AMotorThatCouldNotBeSwitchedOnDoesNotStartLongAfter) {
  build();
  act(DriveAction::off, 200);
  drive().servo().set_torque_off(true);
  command_.torque_nm[0] = 1;
  act(DriveAction::torque, 4000);
  EXPECT_FALSE(has(kFault));
  cycle(1100);
  EXPECT_TRUE(has(kFault));
  EXPECT_NE(drivers_[0]->why_not_ready().find("cannot be switched on"), std::string::npos);
  drive().servo().set_torque_off(false);
  expect_off_until_it_is_switched_off_and_on();
}

TEST_F(Cia402Safety, ATorqueThatGrewWhileTheDriveSwitchedOnComesSlowly) {
  build({.torque_slew_nm_s = 20, .enable_ns = 300 * kMs});
  act(DriveAction::off, 200);
  command_.torque_nm[0] = 3;
  act(DriveAction::torque);
  while (drive_state() != State::operation_enabled) cycle();
  cycle(20);
  EXPECT_GT(plant().torque_nm(), 0.2);
  EXPECT_LT(plant().torque_nm(), 0.5);
  cycle(200);
  EXPECT_NEAR(plant().torque_nm(), 3, 0.05);
}

TEST_F(Cia402Safety, ASoftStartBeginsWhenTheDriveIsOn) {
  build({.soft_start_s = 1, .enable_ns = 300 * kMs});
  act(DriveAction::off, 200);
  command_.torque_nm[0] = 4;
  act(DriveAction::torque, 10);
  while (drive_state() != State::operation_enabled) cycle();
  cycle(250);
  EXPECT_NEAR(plant().torque_nm(), 1, 0.1);
}

TEST_F(Cia402Safety, ADriveThatFellBackWhileItDroveLosesItsTorque) {
  build({.refuses_while_on = true});
  enable();
  command_.torque_nm[0] = 0.5;
  cycle(50);
  tell_network(canopen::NmtCommand::enter_pre_operational);
  cycle(110);  // a heartbeat every 100 ms
  EXPECT_NE(drive().servo().state(), State::operation_enabled);
  cycle(400);
  EXPECT_NEAR(plant().torque_nm(), 0, 1e-6);
  EXPECT_EQ(drivers_[0]->why_not_ready(), "") << "it was set up again";
}

TEST_F(Cia402Safety, OneThatRefusesWhileItDrivesIsResetAndNotForEver) {
  build({.refuses_while_on = true});
  enable();
  command_.torque_nm[0] = 0.5;
  cycle(50);
  int resets = 0;
  cables_[0]->there = [&resets](Frame& frame) {
    resets += frame.id == 0 && frame.data[0] == 0x81;
    const bool controls = frame.id == 0x601 && canopen::sdo_address(frame).index == 0x6040;
    if (controls) put_little_endian(frame.data.data() + 1, 0x2000, 2);  // no such object
    return true;
  };
  cables_[0]->back = [](Frame& frame) {
    const bool controls = frame.id == 0x581 && canopen::sdo_address(frame).index == 0x2000;
    if (controls) put_little_endian(frame.data.data() + 1, 0x6040, 2);
    return true;
  };
  tell_network(canopen::NmtCommand::enter_pre_operational);
  cycle(500);
  EXPECT_EQ(resets, 1);
  EXPECT_NEAR(plant().torque_nm(), 0, 1e-6);
  EXPECT_EQ(drivers_[0]->why_not_ready(), "");
  // One that says no after that reset, too, is left alone.
  cables_[0]->there = [&resets](Frame& frame) {
    resets += frame.id == 0 && frame.data[0] == 0x81;
    return true;
  };
  cables_[0]->back = [](Frame& frame) {
    const canopen::Address at = canopen::sdo_address(frame);
    if (frame.id == 0x581 && at.index == 0x6007) frame = canopen::sdo_abort(0x581, at, canopen::abort_code::kState);
    return true;
  };
  tell_network(canopen::NmtCommand::enter_pre_operational);
  cycle(2000);
  EXPECT_EQ(resets, 2);
  EXPECT_FALSE(drivers_[0]->running());
}

TEST_F(Cia402Safety, ACommandThatTheBusRefusedIsAMissedAnswer) {
  build();
  enable();
  command_.torque_nm[0] = 0.5;
  cycle(20);
  bus_->room = [](const Frame& frame) { return frame.id != 0x201; };
  cycle(3);
  EXPECT_FALSE(fresh());
  EXPECT_TRUE(has(wire::joint_status::kLost));
  EXPECT_TRUE(fresh(1));
}

TEST_F(Cia402Safety, ALostHeartbeatIsAFaultAlsoWhileAnswersCome) {
  build();
  accelerate();
  cables_[0]->back = [](Frame& frame) { return frame.id != 0x701; };
  command_.torque_nm[0] = 0.1;
  cycle(450);
  EXPECT_TRUE(fresh());
  EXPECT_TRUE(has(kFault));
  EXPECT_NE(drivers_[0]->why_not_ready().find("heartbeat"), std::string::npos);
  act(DriveAction::off, 20);
  act(DriveAction::torque, 200);
  EXPECT_NE(drive_state(), State::operation_enabled) << "off and on brings no heartbeat back";
  cables_[0]->back = [](Frame&) { return true; };
  cycle(200);
  EXPECT_NE(drive_state(), State::operation_enabled);
}

// It answers everything and is set up, but nobody would learn that it is gone.
TEST_F(Cia402Safety, ADriveThatDoesNotBeatSaysSoAndIsNotSwitchedOn) {
  build();
  act(DriveAction::off, 2);
  cables_[0]->back = [](Frame& frame) { return frame.id != 0x701 || frame.data[0] == 0; };  // but for its boot-up
  drive().inject(InjectedFault::power_loss, true, now_ns_);
  cycle(600);
  EXPECT_NE(drivers_[0]->why_not_ready().find("heartbeat"), std::string::npos) << drivers_[0]->why_not_ready();
  act(DriveAction::torque, 50);
  EXPECT_NE(drive_state(), State::operation_enabled);
  EXPECT_TRUE(has(kFault));
  cables_[0]->back = [](Frame&) { return true; };
  cycle(600);
  act(DriveAction::off, 2);
  act(DriveAction::torque, 20);
  EXPECT_EQ(drive_state(), State::operation_enabled);
  EXPECT_EQ(drivers_[0]->why_not_ready(), "");
}

TEST_F(Cia402Safety, ADriveThatTellsTurnsPerMinuteIsFoundOut) {
  build({.velocity_unit = 60.0 / 65536});
  enable();
  command_.torque_nm[0] = command_.torque_nm[1] = 0.3;
  cycle(1500);
  EXPECT_TRUE(has(kFault));
  EXPECT_FALSE(has(kFault, 1));
  EXPECT_NE(drive_state(), State::operation_enabled);
  EXPECT_EQ(drive_state(1), State::operation_enabled);
  EXPECT_NE(drivers_[0]->why_not_ready().find("606Ch is 0.001"), std::string::npos) << drivers_[0]->why_not_ready();
  act(DriveAction::off, 2);
  act(DriveAction::torque, 50);
  EXPECT_NE(drive_state(), State::operation_enabled) << "its unit is still wrong";
}

TEST_F(Cia402Safety, ASecondFaultWhoseEmergencyIsLostIsNotNamedAfterTheFirst) {
  build();
  enable();
  cables_[0]->back = [](Frame& frame) { return frame.id != 0x081; };
  constexpr std::array<std::pair<std::uint16_t, std::uint32_t>, 2> kFaults{
      {{canopen::emergency::kOverCurrent, 0x23}, {canopen::emergency::kTooHot, 0x42}}};
  for (const auto& [code, name] : kFaults) {
    drive().inject(code);
    cycle(50);
    EXPECT_EQ(fault_class(), name);
    drive().inject(canopen::emergency::kGone);
    act(DriveAction::off, 5);
    act(DriveAction::torque, 10);
    ASSERT_EQ(drive_state(), State::operation_enabled);
    EXPECT_EQ(fault_class(), 0U);
  }
}

TEST_F(Cia402Safety, ProductsThatAreNotFiniteAreNoTorque) {
  build();
  enable();
  command_.position_rad[0] = 1e200;
  command_.kp_nm_rad[0] = 1e200;
  cycle(5);
  EXPECT_EQ(drive_state(), State::operation_enabled);
  EXPECT_EQ(drive().dictionary().value(0x6071), 0U);
}

TEST_F(Cia402Safety, APositionDriveNeverMovesFasterThanItsJointMay) {
  build({.mode = Mode::position, .velocity_max_rad_s = 2});
  enable();
  command_.position_rad[0] = state_.position_rad[0] + 2;
  double fastest = 0;
  for (int i = 0; i < 1500; ++i) {
    cycle();
    fastest = std::max(fastest, std::abs(plant().velocity_rad_s()));
  }
  EXPECT_LT(fastest, 2.2);
  EXPECT_GT(fastest, 1.8);
  EXPECT_NEAR(state_.position_rad[0], command_.position_rad[0], 0.01);
}

TEST_F(Cia402Safety, APositionDriveCatchesUpWithATargetThatMoves) {
  build({.mode = Mode::position, .velocity_max_rad_s = 2});
  enable();
  const double from_rad = state_.position_rad[0];
  double furthest = -10;
  for (int i = 0; i < 2000; ++i) {
    command_.position_rad[0] = from_rad + 0.5 + 1e-3 * i;
    cycle();
    furthest = std::max(furthest, plant().position_rad() - command_.position_rad[0]);
  }
  EXPECT_NEAR(state_.position_rad[0], command_.position_rad[0], 0.01);
  EXPECT_LT(furthest, 0.01);
}

TEST_F(Cia402Safety, APositionDriveWithoutAPositionSlowsDownFromWhereItWas) {
  build({.mode = Mode::position, .velocity_max_rad_s = 2});
  enable();
  command_.position_rad[0] = state_.position_rad[0] + 2;
  cycle(500);
  const double from_rad = state_.position_rad[0];
  command_.position_rad[0] = kNan;
  cycle(500);
  EXPECT_NEAR(state_.position_rad[0] - from_rad, 2.0 * 2.0 / (2 * 20), 0.05);  // v^2 / 2a, and what it lagged behind
  EXPECT_NEAR(plant().velocity_rad_s(), 0, 0.05);
}

TEST_F(Cia402Safety, AVelocityDriveChangesItsSpeedAsFastAsItsJointMay) {
  build({.mode = Mode::velocity, .velocity_max_rad_s = 4});
  enable();
  command_.velocity_rad_s[0] = 10;
  cycle(100);
  EXPECT_NEAR(plant().velocity_rad_s(), 2, 0.4);
  cycle(300);
  EXPECT_NEAR(plant().velocity_rad_s(), 4, 0.1);
  command_.velocity_rad_s[0] = 0;
  cycle(100);
  EXPECT_NEAR(plant().velocity_rad_s(), 2, 0.4);
}

TEST_F(Cia402Safety, DrivesThatAreAskedLessOftenMoveAsSmoothly) {
  build({.mode = Mode::position, .divider = 4});
  int syncs = 0, answers = 0;
  act(DriveAction::off, 600);
  act(DriveAction::torque, 100);
  ASSERT_EQ(drive_state(0), State::operation_enabled);
  ASSERT_EQ(drive_state(1), State::operation_enabled);
  const std::uint64_t missed = actuators_.counters().missed;
  const double from_rad = state_.position_rad[0];
  cables_[0]->there = [&syncs](Frame& frame) {
    syncs += frame.id == 0x080;
    return true;
  };
  cables_[0]->back = [&answers](Frame& frame) {
    answers += frame.id == 0x281;
    return true;
  };
  double slowest_rad_s = 10, fastest_rad_s = 0;
  for (int i = 0; i < 1000; ++i) {
    command_.position_rad[0] = from_rad + 1e-3 * i;
    cycle();
    if (i < 500) continue;
    slowest_rad_s = std::min(slowest_rad_s, plant().velocity_rad_s());
    fastest_rad_s = std::max(fastest_rad_s, plant().velocity_rad_s());
  }
  EXPECT_EQ(syncs, 250);
  EXPECT_EQ(answers, 250);
  EXPECT_EQ(actuators_.counters().missed, missed);
  EXPECT_GT(slowest_rad_s, 0.95);
  EXPECT_LT(fastest_rad_s, 1.05);
}

}  // namespace
}  // namespace lithe::hal
