// SPDX-License-Identifier: Apache-2.0
// Drives that restart, cables that lose frames, devices that are not what they should be, bytes that make no sense.
#include <array>
#include <random>
#include <string>

#include "spine/hal/cia402/test/cia402_line_rig.hpp"

namespace lithe::hal {
namespace {

using cia402::Mode;
using cia402::State;

class Cia402Faults : public Cia402Line {
 protected:
  // What the drive with address 1 answers to an SDO request for this object is replaced by an abort.
  void abort_object(std::uint16_t index, std::uint32_t code) {
    cables_[0]->back = [index, code](Frame& frame) {
      if (frame.id == 0x581 && canopen::sdo_address(frame).index == index)
        frame = canopen::sdo_abort(0x581, canopen::sdo_address(frame), code);
      return true;
    };
  }
  void lose_power() { EXPECT_TRUE(drive().inject(InjectedFault::power_loss, true, now_ns_)); }
  void expect_on_again(int off_ms = 1) {
    act(DriveAction::off, off_ms);
    act(DriveAction::torque, 10);
    EXPECT_EQ(drive_state(), State::operation_enabled);
  }
  // It answers again, and stays off until it is told so once.
  void expect_it_needs_off() {
    EXPECT_TRUE(fresh());
    EXPECT_EQ(drivers_[0]->why_not_ready(), "");
    EXPECT_NE(drive_state(), State::operation_enabled);
    expect_on_again();
  }
  void expect_refused(const std::vector<std::string>& words) {
    act(DriveAction::off, 1000);
    act(DriveAction::torque, 50);
    EXPECT_FALSE(drivers_[0]->running());
    EXPECT_FALSE(fresh(0));
    EXPECT_TRUE(has(wire::joint_status::kLost));
    EXPECT_EQ(drive().servo().state(), State::switch_on_disabled);
    EXPECT_EQ(drive_state(1), State::operation_enabled);  // its neighbour does not mind
    const std::string why = drivers_[0]->why_not_ready();
    for (const std::string& word : words) EXPECT_NE(why.find(word), std::string::npos) << word << " not in: " << why;
  }
};

TEST_F(Cia402Faults, AnotherKindOfDeviceIsRefusedByName) {
  build({.device_type = 0x0003'0191});  // an input and output module
  expect_refused({"1000h", "profile 401", "not 402"});
}

TEST_F(Cia402Faults, ARatedTorqueThatContradictsTheRobotFileIsRefused) {
  build({.rated_torque_nm = 0.8});
  expect_refused({"6076h", "800 mNm", "rated_torque_nm"});
}

TEST_F(Cia402Faults, ADriveWithoutAnObjectThatKeepsItSafeIsRefused) {
  build();
  abort_object(0x6007, canopen::abort_code::kNoObject);
  expect_refused({"6007h", "06020000", "no such object"});
}

TEST_F(Cia402Faults, AModeThatTheDriveDoesNotHaveIsRefused) {
  build();
  cables_[0]->back = [](Frame& frame) {
    if (frame.id == 0x581 && canopen::sdo_address(frame).index == 0x6502) frame.data[5] = 0;
    return true;
  };
  expect_refused({"6502h", "mode"});
}

TEST_F(Cia402Faults, AModeThatIsNotTakenIsRefused) {
  build();
  cables_[0]->back = [](Frame& frame) {
    if (frame.id == 0x581 && canopen::sdo_address(frame).index == 0x6061) frame.data[4] = 1;
    return true;
  };
  expect_refused({"6061h", "stays at 1"});
}

// With its makers' defaults on, it would fill the bus with frames that nobody planned with.
TEST_F(Cia402Faults, AProcessDataThatCannotBeSwitchedOffIsRefused) {
  build();
  abort_object(0x1802, canopen::abort_code::kValue);
  expect_refused({"1802h", "06090030"});
}

TEST_F(Cia402Faults, OneThatIsNotThereNeedNotBeSwitchedOff) {
  build();
  abort_object(0x1802, canopen::abort_code::kNoObject);
  enable();
  EXPECT_EQ(drive_state(), State::operation_enabled);
}

TEST_F(Cia402Faults, ADriveThatKnowsNoRemoteFramesIsSetUp) {
  build({.knows_no_remote = true});
  enable();
  EXPECT_EQ(drivers_[0]->why_not_ready(), "");
  EXPECT_EQ(drive_state(), State::operation_enabled);
}

TEST_F(Cia402Faults, AnObjectThatMayBeMissingMayBeMissing) {
  build();
  abort_object(0x60c2, canopen::abort_code::kNoObject);
  enable();
  EXPECT_EQ(drive_state(), State::operation_enabled);
}

TEST_F(Cia402Faults, APositionDriveMustKnowItsPeriod) {
  build({.mode = Mode::position});
  abort_object(0x60c2, canopen::abort_code::kNoObject);
  expect_refused({"60C2h"});
}

TEST_F(Cia402Faults, ADriveThatIsNotThereIsLookedForAgain) {
  build();
  cables_[0]->there = cables_[0]->back = [](Frame&) { return false; };
  int resets = 0;
  act(DriveAction::off, 100);
  EXPECT_NE(drivers_[0]->why_not_ready().find("boot-up"), std::string::npos);
  cables_[0]->there = [&resets](Frame& frame) {
    resets += frame.id == 0 && frame.data[0] == 0x81 && frame.data[1] == 1;
    return true;
  };
  cables_[0]->back = [](Frame&) { return true; };
  act(DriveAction::off, 6000);
  EXPECT_EQ(resets, 1);
  EXPECT_TRUE(fresh());
}

TEST_F(Cia402Faults, ADriveThatRestartsIsSetUpAgainAndWaitsForOff) {
  build();
  enable();
  command_.torque_nm[0] = 0.1;
  cycle(20);
  lose_power();
  cycle(4);
  EXPECT_FALSE(fresh());
  EXPECT_TRUE(fresh(1));
  EXPECT_EQ(drive_state(1), State::operation_enabled);
  cycle(300);
  EXPECT_TRUE(fresh());
  EXPECT_EQ(drive().dictionary().value(0x6007), 3U);
  EXPECT_EQ(drive_state(), State::switch_on_disabled);  // it does not start by itself
  expect_on_again();
}

TEST_F(Cia402Faults, ARestartInTheMiddleOfTheSetUpStartsItAgain) {
  build();
  for (int at = 1; at < 60; at += 7) {
    act(DriveAction::off, 105 + at);
    lose_power();
  }
  expect_on_again(300);
}

TEST_F(Cia402Faults, ADriveThatSomebodyStoppedIsSetUpAgain) {
  build();
  enable();
  FrameQueue unheard;
  drive().on_frame(canopen::nmt_frame(canopen::NmtCommand::stop, 1), now_ns_, unheard);
  cycle(300);
  EXPECT_TRUE(fresh());
  EXPECT_TRUE(has(wire::joint_status::kWatchdog));
  expect_on_again(2);
}

TEST_F(Cia402Faults, ASilentDriveIsLostAndNeedsOffWhenItIsBack) {
  build();
  enable();
  for (const int silent_ms : {500, 1500}) {
    cables_[0]->there = cables_[0]->back = [](Frame&) { return false; };
    cycle(silent_ms);
    EXPECT_TRUE(has(wire::joint_status::kLost));
    EXPECT_NE(drivers_[0]->why_not_ready().find("heartbeat"), std::string::npos);
    cables_[0]->there = cables_[0]->back = [](Frame&) { return true; };
    cycle(300);
    expect_it_needs_off();
  }
}

// Its boot-up message was heard by nobody, and after that it never speaks by itself.
TEST_F(Cia402Faults, ADriveThatRestartedWhileNobodyHeardItIsFoundAgain) {
  build();
  enable();
  cables_[0]->there = cables_[0]->back = [](Frame&) { return false; };
  cycle(100);
  lose_power();
  cycle(900);
  cables_[0]->there = cables_[0]->back = [](Frame&) { return true; };
  cycle(6000);
  expect_it_needs_off();
}

TEST_F(Cia402Faults, OneFrameInTenLostDelaysTheStartAndNothingElse) {
  build({.lost_after_misses = 20});
  std::mt19937 random(3);
  for (auto& cable : cables_) cable->there = cable->back = [&random](Frame&) { return random() % 10 != 0; };
  act(DriveAction::off, 20'000);
  act(DriveAction::torque, 50);
  std::uint32_t enabled = 0;
  for (int i = 0; i < 1000; ++i) {
    cycle();
    enabled += drive_state(0) == State::operation_enabled && drive_state(1) == State::operation_enabled;
  }
  EXPECT_EQ(enabled, 1000U);
  EXPECT_GT(actuators_.counters().missed, 100U);
}

TEST_F(Cia402Faults, AVelocityThatIsLostTwiceMakesTheAnswerWorthless) {
  build();
  enable();
  cables_[0]->back = [](Frame& frame) { return frame.id != 0x181; };
  cycle(2);
  EXPECT_TRUE(fresh());
  cycle(2);
  EXPECT_FALSE(fresh());
}

TEST_F(Cia402Faults, AnAnswerOfBeforeTheSyncIsLate) {
  build();
  enable();
  Frame held;
  cables_[0]->back = [&held](Frame& frame) {
    if (frame.id == 0x281) held = frame;
    return frame.id != 0x281;
  };
  cycle();
  EXPECT_FALSE(fresh());
  JointSample sample;
  Exchange next{.number = command_.tick + 1, .now_ns = now_ns_, .source = 0, .asked = false};
  EXPECT_EQ(drivers_[0]->on_frame(held, next, sample), ReplyKind::late);
  next.asked = true;  // the others are asked, this joint is not
  EXPECT_EQ(drivers_[0]->on_frame(held, next, sample), ReplyKind::late);
  --next.number;
  EXPECT_EQ(drivers_[0]->on_frame(held, next, sample), ReplyKind::answer);
}

TEST_F(Cia402Faults, ADriveThatStartsAnewSaysSoUntilItIsSetUp) {
  build();
  enable();
  lose_power();
  bool left = false;
  for (int i = 0; i < 500 && !(left && drivers_[0]->running()); ++i) {
    cycle();
    left |= !drivers_[0]->running();
    EXPECT_TRUE(drivers_[0]->running() || !drivers_[0]->why_not_ready().empty()) << i;
  }
  EXPECT_TRUE(left && drivers_[0]->running());
}

TEST_F(Cia402Faults, WhatNoMotorDoesIsNotMeasured) {
  build();
  enable();
  cycle();
  const double position_rad = state_.position_rad[0], velocity_rad_s = state_.velocity_rad_s[0];
  for (const std::uint32_t id : {0x181U, 0x281U}) {
    cables_[0]->back = [id](Frame& frame) {
      const std::size_t at = id == 0x181 ? 0 : 6;  // 2^30 counts per second; 30 times the rated torque
      const std::size_t bytes = id == 0x181 ? 4 : 2;
      if (frame.id == id) put_little_endian(frame.data.data() + at, id == 0x181 ? 0x4000'0000 : 30'000, bytes);
      return true;
    };
    const std::uint64_t malformed = actuators_.counters().malformed;
    cycle(2);
    EXPECT_FALSE(fresh());
    EXPECT_GE(actuators_.counters().malformed, malformed + 1);
    EXPECT_NEAR(state_.position_rad[0], position_rad, 0.1);
    EXPECT_NEAR(state_.velocity_rad_s[0], velocity_rad_s, 1);
    cables_[0]->back = [](Frame&) { return true; };
    cycle(3);
    EXPECT_TRUE(fresh());
  }
}

TEST_F(Cia402Faults, AJointThatCannotFollowFaults) {
  build({.mode = Mode::position, .velocity_max_rad_s = 1000});
  enable();
  command_.position_rad[0] = state_.position_rad[0];
  for (int i = 0; i < 200; ++i) {
    command_.position_rad[0] += 0.1;  // faster by far than its torque can make it
    cycle();
  }
  EXPECT_TRUE(has(wire::joint_status::kFault));
  EXPECT_EQ(fault_class(), 0x86U);
}

// A frame that looks as if it could be ours, or any other.
Frame random_frame(std::mt19937& random) {
  constexpr std::array<std::uint32_t, 8> kFunctions{0x000, 0x080, 0x180, 0x280, 0x201, 0x580, 0x600, 0x700};
  Frame frame;
  const auto near = static_cast<std::uint32_t>(kFunctions[random() % kFunctions.size()] + random() % 3);
  frame.id = random() % 4 == 0 ? static_cast<std::uint32_t>(random() & 0x7ff) : near;
  frame.size = static_cast<std::uint8_t>(random() % 10 == 0 ? random() % 256 : random() % 9);
  frame.extended = random() % 20 == 0;
  frame.fd = random() % 20 == 0;
  for (std::uint8_t& byte : frame.data) byte = static_cast<std::uint8_t>(random() % 3 == 0 ? random() : random() % 16);
  return frame;
}

TEST_F(Cia402Faults, NoBytesMakeTheDriverSayNonsense) {
  build();
  enable();
  std::mt19937 random(11);
  Exchange exchange{.number = 1'000'000, .now_ns = now_ns_, .source = 0, .asked = true};
  for (int i = 0; i < 100'000; ++i) {
    exchange.number += random() % 2;
    exchange.now_ns += static_cast<std::int64_t>(random() % kMs);
    exchange.asked = random() % 4 != 0;
    JointSample sample;
    const ReplyKind heard = drivers_[0]->on_frame(random_frame(random), exchange, sample);
    if (heard == ReplyKind::answer) {
      ASSERT_TRUE(std::isfinite(sample.position_rad) && std::isfinite(sample.velocity_rad_s));
      ASSERT_TRUE(std::isfinite(sample.torque_nm));
    }
    if (i % 5 != 0) continue;
    const std::uint64_t sent = bus_->statistics().sent;
    bus_->begin(exchange.now_ns);
    drivers_[0]->command({{}, static_cast<DriveAction>(random() % 4), 0, false}, exchange, *bus_);
    ASSERT_LE(bus_->statistics().sent - sent, 2U);
  }
  now_ns_ = exchange.now_ns;
  lose_power();
  act(DriveAction::off, 6000);  // and it recovers
  act(DriveAction::torque, 20);
  EXPECT_EQ(drive_state(), State::operation_enabled);
}

TEST_F(Cia402Faults, NoBytesBreakTheSimulatedDrive) {
  build();
  enable();
  std::mt19937 random(12);
  FrameQueue answers;
  for (int i = 0; i < 100'000; ++i) {
    now_ns_ += static_cast<std::int64_t>(random() % (kMs / 4));
    drive().on_frame(random_frame(random), now_ns_, answers);
    ASSERT_LE(answers.size(), 16U);
    answers.clear();
    ASSERT_TRUE(std::isfinite(plant().position_rad()) && std::isfinite(plant().velocity_rad_s()));
  }
  EXPECT_GT(drive().refused(), 1000U);
  act(DriveAction::off, 6000);
  lose_power();
  act(DriveAction::off, 400);
  act(DriveAction::torque, 20);
  EXPECT_EQ(drive_state(), State::operation_enabled);
}

}  // namespace
}  // namespace lithe::hal
