// SPDX-License-Identifier: Apache-2.0
// Our driver and our simulated drive, with a bus between them: what a joint does when it is told to.
#include <algorithm>
#include <string>

#include "spine/core/test/no_alloc_rig.hpp"
#include "spine/hal/cia402/test/cia402_line_rig.hpp"

namespace lithe::hal {
namespace {

using cia402::Mode;
using cia402::State;

class Cia402Drives : public Cia402Line {};

bool is_write_of(const Frame& frame, std::uint32_t index) {
  return canopen::function_of(frame) == canopen::cob::kSdoRequest && (frame.data[0] & 0xe0) == 0x20 &&
         canopen::sdo_address(frame).index == index;
}

TEST_F(Cia402Drives, StartUpEndsSetUpAndOffThenEnabled) {
  build();
  EXPECT_NE(drivers_[0]->why_not_ready(), "");
  act(DriveAction::off, 3);
  EXPECT_FALSE(fresh());
  act(DriveAction::off, 197);
  EXPECT_EQ(drivers_[0]->why_not_ready(), "");
  EXPECT_TRUE(fresh(0));
  EXPECT_TRUE(fresh(1));
  EXPECT_EQ(drive_state(), State::switch_on_disabled);
  EXPECT_EQ(plant().torque_nm(), 0);
  act(DriveAction::torque, 10);
  EXPECT_EQ(drive_state(), State::operation_enabled);
  EXPECT_FALSE(has(wire::joint_status::kFault));
  EXPECT_EQ(actuators_.counters().malformed, 0U);
  EXPECT_EQ(actuators_.counters().stray, 0U);
}

TEST_F(Cia402Drives, SetUpLeavesTheObjectsThatKeepAJointSafe) {
  build();
  act(DriveAction::off, 200);
  const sim::Cia402Dictionary& said = drive().dictionary();
  EXPECT_EQ(said.value(0x1016, 1), 127U << 16 | 100U);
  EXPECT_EQ(said.value(0x6007), 3U);
  EXPECT_EQ(said.value(0x605a), 2U);
  EXPECT_EQ(said.value(0x6072), 800U);  // 4 Nm behind 1:10 with a motor of 0.5 Nm
  EXPECT_EQ(said.value(0x60c2, 1), 1U);
  EXPECT_EQ(said.signed_value(0x60c2, 2), -3);
  EXPECT_EQ(said.value(0x6060), 10U);
  EXPECT_EQ(said.value(0x1600, 1), 0x60400010U);
  EXPECT_EQ(said.value(0x1a01, 2), 0x60640020U);
  EXPECT_EQ(said.value(0x1801, 2), 1U);
}

TEST_F(Cia402Drives, TorqueMovesTheJointItsWayThroughSignZeroAndRatio) {
  build();
  enable();
  EXPECT_NEAR(state_.position_rad[0], 0.2, 1e-4);
  command_.torque_nm[0] = 0.5;
  command_.torque_nm[1] = -0.5;
  const double before = plant().velocity_rad_s();
  cycle(100);
  EXPECT_NEAR(plant().velocity_rad_s() - before, 0.1 * 0.5 / 0.05, 0.05);
  EXPECT_NEAR(state_.torque_nm[0], 0.5, 0.01);
  EXPECT_NEAR(state_.torque_nm[1], -0.5, 0.01);
  EXPECT_NEAR(state_.velocity_rad_s[0], plant(0).velocity_rad_s(), 0.05);
  EXPECT_NEAR(state_.velocity_rad_s[1], plant(1).velocity_rad_s(), 0.05);
  EXPECT_NEAR(state_.position_rad[0], plant(0).position_rad(), 2e-3);
  EXPECT_GT(state_.position_rad[0], 0.2);
  EXPECT_LT(state_.position_rad[1], 0.2);
}

TEST_F(Cia402Drives, ATorqueDriveClosesThePdLoopOfTheCommand) {
  build();
  enable();
  command_.position_rad[0] = 0.6;
  command_.kp_nm_rad[0] = 5;
  command_.kd_nm_s_rad[0] = 1;
  cycle(1500);
  EXPECT_NEAR(plant().position_rad(), 0.6, 5e-3);
  EXPECT_NEAR(plant().velocity_rad_s(), 0, 1e-2);
}

TEST_F(Cia402Drives, TorqueNeverExceedsTheCommandsLimitNorTheDrives) {
  build();
  enable();
  command_.torque_nm[0] = 100;
  command_.max_torque_nm[0] = 1;
  cycle(20);
  EXPECT_NEAR(state_.torque_nm[0], 1, 0.01);
  command_.max_torque_nm[0] = 50;
  cycle(20);
  EXPECT_NEAR(state_.torque_nm[0], 4, 0.05);
}

TEST_F(Cia402Drives, APositionDriveStartsWhereItIsAndFollows) {
  build({.mode = Mode::position});
  plant().place(1.1);
  act(DriveAction::off, 200);
  EXPECT_EQ(drive().dictionary().value(0x607a), drive().dictionary().value(0x6064));
  act(DriveAction::torque, 200);
  EXPECT_EQ(drive_state(), State::operation_enabled);
  EXPECT_NEAR(plant().position_rad(), 1.1, 1e-3);  // no jump
  for (int i = 0; i < 1000; ++i) {
    command_.position_rad[0] = 1.1 - 0.5e-3 * i;
    cycle();
  }
  cycle(200);
  EXPECT_NEAR(state_.position_rad[0], 0.6, 2e-3);
  command_.position_rad[0] = kNan;  // none: it holds
  cycle(200);
  EXPECT_NEAR(state_.position_rad[0], 0.6, 2e-3);
}

TEST_F(Cia402Drives, TheTorqueOffsetCarriesAPositionDrivesLoad) {
  build({.mode = Mode::position, .mgl_nm = 2});
  enable();
  command_.position_rad[0] = state_.position_rad[0];
  cycle(300);
  const double sagged = std::abs(plant().position_rad() - command_.position_rad[0]);
  command_.torque_nm[0] = 2 * std::sin(command_.position_rad[0]);
  cycle(300);
  EXPECT_LT(std::abs(plant().position_rad() - command_.position_rad[0]), sagged / 4);
}

TEST_F(Cia402Drives, AVelocityDriveTurnsAsFastAsItIsTold) {
  build({.mode = Mode::velocity});
  enable();
  command_.velocity_rad_s[0] = 1.5;
  command_.velocity_rad_s[1] = -0.7;
  cycle(300);
  EXPECT_NEAR(state_.velocity_rad_s[0], 1.5, 0.05);
  EXPECT_NEAR(state_.velocity_rad_s[1], -0.7, 0.05);
}

TEST_F(Cia402Drives, DampingIsAQuickStopThatEndsOff) {
  build({.mode = Mode::velocity});
  enable();
  command_.velocity_rad_s[0] = 5;
  cycle(300);
  act(DriveAction::damp, 5);
  EXPECT_EQ(drive_state(), State::quick_stop_active);
  cycle(500);
  EXPECT_EQ(drive_state(), State::switch_on_disabled);
  EXPECT_NEAR(plant().velocity_rad_s(), 0, 0.05);
  EXPECT_FALSE(has(wire::joint_status::kFault));
  act(DriveAction::torque, 10);
  EXPECT_EQ(drive_state(), State::operation_enabled);
}

TEST_F(Cia402Drives, OffAndBrakeTakeThePowerAtOnce) {
  for (const DriveAction action : {DriveAction::off, DriveAction::brake}) {
    if (bus_ == nullptr) build();
    enable();
    command_.torque_nm[0] = 0.5;
    cycle(50);
    act(action, 2);
    EXPECT_EQ(drive_state(), State::switch_on_disabled);
    EXPECT_EQ(state_.torque_nm[0], 0);
  }
}

TEST_F(Cia402Drives, NothingAllocatesFromTheFirstExchangeOn) {
  build();
  const NoAllocScope scope;
  enable();
  command_.torque_nm[0] = 0.5;
  cycle(20);
  act(DriveAction::damp, 20);
}

TEST_F(Cia402Drives, AnUnsoundCommandStopsItsJointAndIsCounted) {
  build();
  enable();
  command_.torque_nm[1] = kNan;
  cycle(20);
  EXPECT_EQ(actuators_.counters().unsound, 20U);
  EXPECT_EQ(drive_state(0), State::operation_enabled);
  EXPECT_NE(drive_state(1), State::operation_enabled);
}

TEST_F(Cia402Drives, WhenTheHostDiesTheDriveStopsByItselfAndStaysOff) {
  build({.mode = Mode::velocity});
  enable();
  command_.velocity_rad_s[0] = 5;
  cycle(300);
  ASSERT_GT(plant().velocity_rad_s(), 4);
  silence(90);
  EXPECT_GT(plant().velocity_rad_s(), 4);  // its time is not over yet
  silence(600);
  EXPECT_NEAR(plant().velocity_rad_s(), 0, 0.05);
  EXPECT_EQ(drive().servo().state(), State::switch_on_disabled);
  EXPECT_EQ(drive().network_state(), canopen::NmtState::pre_operational);
  cycle(300);  // the host is back, and still says torque
  EXPECT_TRUE(fresh());
  EXPECT_TRUE(has(wire::joint_status::kWatchdog));
  EXPECT_EQ(drive_state(), State::switch_on_disabled);
  act(DriveAction::off);
  act(DriveAction::torque, 20);
  EXPECT_EQ(drive_state(), State::operation_enabled);
  EXPECT_FALSE(has(wire::joint_status::kWatchdog));
}

TEST_F(Cia402Drives, AHostThatDiesBeforeItsSecondHeartbeatStopsTheDriveToo) {
  build({.mode = Mode::velocity, .heartbeat_s = 3600});
  act(DriveAction::off, 60);
  command_.velocity_rad_s[0] = 5;
  act(DriveAction::torque, 30);
  ASSERT_EQ(drive_state(), State::operation_enabled);
  silence(700);
  EXPECT_EQ(drive().servo().state(), State::switch_on_disabled);
}

// The broken twin of the tests above: the same, but the drive is told to watch nobody.
TEST_F(Cia402Drives, ADriveThatWatchesNobodyGoesOnWhenTheHostDies) {
  build({.mode = Mode::velocity});
  cables_[0]->there = [](Frame& frame) {
    if (is_write_of(frame, 0x1016)) std::fill_n(frame.data.begin() + 4, 4, std::uint8_t{0});
    return true;
  };
  enable();
  command_.velocity_rad_s[0] = 5;
  cycle(300);
  silence(700);
  EXPECT_GT(plant().velocity_rad_s(), 4);
}

TEST_F(Cia402Drives, ADriveThatCannotBeToldToWatchIsNeverEnabled) {
  build();
  cables_[0]->there = [](Frame& frame) { return !is_write_of(frame, 0x1016); };
  act(DriveAction::off, 2500);
  EXPECT_FALSE(drivers_[0]->running());
  EXPECT_TRUE(drivers_[1]->running());
  EXPECT_NE(drivers_[0]->why_not_ready().find("1016h"), std::string::npos) << drivers_[0]->why_not_ready();
}

TEST_F(Cia402Drives, AFaultIsReportedHeldAndResetByOffThenTorqueOnly) {
  build();
  enable();
  drive().inject(canopen::emergency::kTooHot);
  cycle(50);
  EXPECT_TRUE(has(wire::joint_status::kFault));
  EXPECT_EQ(drive_state(), State::fault);
  EXPECT_EQ(fault_class(), 0x42U);
  EXPECT_FALSE(has(wire::joint_status::kFault, 1));
  drive().inject(canopen::emergency::kGone);
  cycle(100);
  EXPECT_EQ(drive_state(), State::fault);  // torque alone resets nothing
  act(DriveAction::damp, 10);
  act(DriveAction::torque, 10);
  EXPECT_EQ(drive_state(), State::fault);
  act(DriveAction::off, 5);
  EXPECT_EQ(drive_state(), State::fault);
  act(DriveAction::torque, 10);
  EXPECT_EQ(drive_state(), State::operation_enabled);
  EXPECT_FALSE(has(wire::joint_status::kFault));
  EXPECT_EQ(fault_class(), 0U);
}

TEST_F(Cia402Drives, AFaultWhoseCauseStaysIsNotResetAndTriedOnce) {
  build();
  enable();
  drive().inject(canopen::emergency::kSensor);
  cycle(50);
  int resets = 0;
  bool before = false;
  cables_[0]->there = [&resets, &before](Frame& frame) {
    if (frame.id == 0x201) {
      const bool now = (frame.data[0] & 0x80) != 0;
      resets += now && !before;
      before = now;
    }
    return true;
  };
  act(DriveAction::off, 5);
  act(DriveAction::torque, 6000);
  EXPECT_EQ(drive_state(), State::fault);
  EXPECT_EQ(fault_class(), 0x73U);
  EXPECT_NE(drivers_[0]->why_not_ready().find("cannot be switched on (now: fault)"), std::string::npos);
  drive().inject(canopen::emergency::kGone);
  cycle(100);
  EXPECT_EQ(drive_state(), State::fault);
  EXPECT_EQ(resets, 1);
  EXPECT_FALSE(before);
}

// A drive takes its time, or the reset is lost on the way.
TEST_F(Cia402Drives, AFaultThatTheDriveResetsLateIsResetAllTheSame) {
  build();
  enable();
  drive().inject(canopen::emergency::kTooHot);
  cycle(50);
  drive().inject(canopen::emergency::kGone);
  int lost = 0;
  cables_[0]->there = [&lost](Frame& frame) {
    const bool reset = frame.id == 0x201 && (frame.data[0] & 0x80) != 0;
    return !reset || ++lost > 300;
  };
  act(DriveAction::off, 5);
  act(DriveAction::torque, 320);
  EXPECT_GT(lost, 300);
  EXPECT_EQ(drive_state(), State::operation_enabled);
  EXPECT_FALSE(has(wire::joint_status::kFault));
}

TEST_F(Cia402Drives, AFaultWhoseEmergencyIsLostIsAskedFor) {
  build();
  enable();
  cables_[0]->back = [](Frame& frame) { return frame.id != 0x081; };
  drive().inject(canopen::emergency::kOverCurrent);
  cycle(50);
  EXPECT_EQ(fault_class(), 0x23U);
}

}  // namespace
}  // namespace lithe::hal
