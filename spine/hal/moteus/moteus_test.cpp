// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/moteus/moteus.hpp"
#include "spine/core/test/units_rig.hpp"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <random>
#include <tuple>

#include "spine/hal/moteus/moteus_codec.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::hal::moteus {
namespace {

// What the drive will have in its registers after this frame.
std::map<std::uint32_t, double> written(const Frame& frame) {
  std::map<std::uint32_t, double> registers;
  SubframeReader reader(frame.payload());
  Subframe s;
  while (reader.next(s))
    for (std::uint32_t i = 0; s.kind == Kind::write && i < s.count; ++i) registers[s.start + i] = s.value(i);
  EXPECT_TRUE(reader.well_formed());
  return registers;
}

Frame reply(std::uint32_t id, double mode, double position, double velocity, double torque, double home, double fault) {
  Frame frame;
  frame.id = id << 8;
  SubframeWriter writer(frame);
  writer.reply(Format::int8, reg::kMode, std::array{mode}, false);
  writer.reply(Format::float32, reg::kPosition, std::array{position, velocity, torque}, false);
  writer.reply(Format::int8, reg::kHomeState, std::array{home, 24.0, 25.0, fault}, true);
  EXPECT_EQ(frame.size, 24);
  return frame;
}

JointCommand torque_command(double torque_nm) {
  JointCommand command;
  command.action = DriveAction::torque;
  command.torque_nm = torque_nm;
  command.max_torque_nm = 0.6;
  return command;
}

TEST(MoteusDriver, PureTorqueIsPositionModeWithoutPositionSoThatTheWatchdogRuns) {
  const MoteusDrive driver({.id = 3, .watchdog_s = 0.2, .joint = {}});
  Frame frame;
  EXPECT_TRUE(driver.encode(torque_command(0.125), 0, frame));
  EXPECT_EQ(frame.id, 0x8003U);
  EXPECT_TRUE(frame.extended && frame.fd && frame.brs);
  EXPECT_EQ(frame.size, 48);
  EXPECT_EQ(frame.data[0], 0x01) << "the mode comes first: writing it resets the rest";
  EXPECT_EQ(frame.data[1], 0x00);
  auto r = written(frame);
  EXPECT_EQ(r.at(reg::kMode), 10);
  EXPECT_TRUE(std::isnan(r.at(reg::kCommandPosition)));
  EXPECT_EQ(r.at(reg::kCommandVelocity), 0);
  EXPECT_EQ(r.at(reg::kCommandTorque), 0.125);
  EXPECT_EQ(r.at(reg::kKpScale), 0);
  EXPECT_EQ(r.at(reg::kKdScale), 0);
  EXPECT_EQ(r.at(reg::kIntegralScale), 0);
  EXPECT_FLOAT_EQ(static_cast<float>(r.at(reg::kMaxTorque)), 0.6F);
  EXPECT_NEAR(r.at(reg::kWatchdog), 0.2, 1e-9);
  EXPECT_EQ(r.at(reg::kVelocityLimit), -1);
  EXPECT_EQ(r.at(reg::kAccelerationLimit), -1);
  EXPECT_EQ(r.count(reg::kStopPosition), 0U) << "deprecated, and a fault together with limits";
}

TEST(MoteusDriver, TheWholeTorqueFrameIsAsWritten) {
  const MoteusDrive driver({.id = 1, .watchdog_s = 0.2, .joint = {}});
  Frame frame;
  driver.encode(torque_command(0.125), 0, frame);
  // mode 10 | NaN 0 .125 0 0 .6 | watchdog 200 ms | no limits | no integral | query
  const std::array<std::uint8_t, 48> expected{0x01, 0x00, 0x0a, 0x0c, 0x06, 0x20, 0x00, 0x00, 0xc0, 0x7f, 0x00, 0x00,
                                              0x00, 0x00, 0x00, 0x00, 0x00, 0x3e, 0x00, 0x00, 0x00, 0x00, 0x00, 0x00,
                                              0x00, 0x00, 0x9a, 0x99, 0x19, 0x3f, 0x05, 0x27, 0xc8, 0x00, 0x02, 0x28,
                                              0xf6, 0xec, 0x01, 0x2b, 0x00, 0x11, 0x00, 0x1f, 0x01, 0x10, 0x04, 0x0c};
  EXPECT_EQ(frame.data[44], expected[44]);
  for (std::size_t i = 0; i < expected.size(); ++i) EXPECT_EQ(frame.data[i], expected[i]) << "byte " << i;
}

TEST(MoteusDriver, OffDampAndBrakeAreModesOnly) {
  const MoteusDrive driver({.id = 1, .joint = {}});
  Frame frame;
  for (const auto& [action, mode] :
       std::map<DriveAction, double>{{DriveAction::off, 0}, {DriveAction::damp, 12}, {DriveAction::brake, 15}}) {
    JointCommand command = torque_command(0.3);
    command.action = action;
    EXPECT_TRUE(driver.encode(command, 0, frame));
    const auto r = written(frame);
    EXPECT_EQ(r.size(), 1U);
    EXPECT_EQ(r.at(reg::kMode), mode);
  }
}

TEST(MoteusDriver, SignZeroAndRatioApplyToCommandAndSample) {
  const MoteusDrive driver({.id = 1, .joint = {.sign = -1, .zero_rad = 0.5, .ratio = 6}});
  JointCommand command = torque_command(1.2);
  command.max_torque_nm = 3;
  command.target_rad = 0.5 + kTurn / 12;
  command.target_rad_s = kTurn;
  command.kp_nm_rad = 36 * 4 / kTurn;
  command.kd_nm_s_rad = 36 * 0.05 / kTurn;
  Frame frame;
  ASSERT_TRUE(driver.encode(command, 0, frame));
  const auto r = written(frame);
  EXPECT_NEAR(r.at(reg::kCommandPosition), -0.5, 1e-6);
  EXPECT_NEAR(r.at(reg::kCommandVelocity), -6, 1e-6);
  EXPECT_NEAR(r.at(reg::kCommandTorque), -0.2, 1e-6);
  EXPECT_NEAR(r.at(reg::kMaxTorque), 0.5, 1e-6);
  EXPECT_NEAR(r.at(reg::kKpScale), 1, 1e-6) << "4 Nm per motor turn, as the drive is configured";
  EXPECT_NEAR(r.at(reg::kKdScale), 1, 1e-6);

  JointSample sample;
  ASSERT_TRUE(driver.decode(reply(1, 10, -0.5, -6, -0.2, 2, 0), sample));
  EXPECT_TRUE(sample.measured);
  EXPECT_NEAR(sample.position_rad, command.target_rad, 1e-6);
  EXPECT_NEAR(sample.velocity_rad_s, command.target_rad_s, 1e-6);
  EXPECT_NEAR(sample.torque_nm, 1.2, 1e-6);
}

TEST(MoteusDriver, ANumberThatIsNotFiniteBecomesDamping) {
  const MoteusDrive driver({.id = 1, .joint = {}});
  const double inf = std::numeric_limits<double>::infinity();
  for (const double bad : {kNan, inf, -inf}) {
    for (double JointCommand::* field : std::initializer_list<double JointCommand::*>{
             &JointCommand::torque_nm, &JointCommand::target_rad_s, &JointCommand::kp_nm_rad,
             &JointCommand::kd_nm_s_rad, &JointCommand::max_torque_nm}) {
      JointCommand command = torque_command(0.1);
      command.*field = bad;
      Frame frame;
      EXPECT_FALSE(driver.encode(command, 0, frame));
      EXPECT_EQ(written(frame).at(reg::kMode), 12);
    }
  }
}

TEST(MoteusDriver, NegativeGainsAndLimitsNeverReachTheDrive) {
  const MoteusDrive driver({.id = 1, .joint = {}});
  JointCommand command = torque_command(0.1);
  command.target_rad = 0;
  command.kp_nm_rad = command.kd_nm_s_rad = command.max_torque_nm = -1;
  Frame frame;
  driver.encode(command, 0, frame);
  const auto r = written(frame);
  EXPECT_EQ(r.at(reg::kKpScale), 0);
  EXPECT_EQ(r.at(reg::kKdScale), 0);
  EXPECT_EQ(r.at(reg::kMaxTorque), 0);
}

TEST(MoteusDriver, ModeOneIsAFaultAndModeElevenAWatchdogAndALimitIsNeither) {
  const MoteusDrive driver({.id = 1, .joint = {}});
  JointSample sample;
  ASSERT_TRUE(driver.decode(reply(1, 1, 0, 0, 0, 2, 39), sample));
  EXPECT_EQ(sample.status, wire::joint_status::kFault | 39U << 8 | 1U << 16);
  ASSERT_TRUE(driver.decode(reply(1, 11, 0, 0, 0, 2, 0), sample));
  EXPECT_EQ(sample.status, wire::joint_status::kWatchdog | 11U << 16);
  for (std::uint32_t code = 96; code <= 105; ++code) {
    ASSERT_TRUE(driver.decode(reply(1, 10, 0, 0, 0, 2, code), sample));
    EXPECT_EQ(sample.status, code << 8 | 10U << 16);
  }
}

TEST(MoteusDriver, AMeasurementThatCannotBeIsNotOne) {
  const MoteusDrive driver({.id = 1, .joint = {}});
  const double inf = std::numeric_limits<double>::infinity();
  for (const double bad : {kNan, inf, -inf, 1e9, -1e9}) {
    for (int at = 0; at < 3; ++at) {
      JointSample sample;
      sample.position_rad = 7;
      ASSERT_TRUE(driver.decode(reply(1, 1, at == 0 ? bad : 0, at == 1 ? bad : 0, at == 2 ? bad : 0, 2, 43), sample));
      EXPECT_FALSE(sample.measured);
      EXPECT_EQ(sample.position_rad, 7) << "keeps what it had";
      EXPECT_EQ(sample.status >> 8 & 0xff, 43U) << "but the fault counts";
    }
  }
}

TEST(MoteusDriver, TheAnswerNamesTheSourceOfItsCommand) {
  const MoteusDrive driver({.id = 5, .joint = {}});
  Frame frame;
  driver.encode(torque_command(0), 9, frame);
  EXPECT_EQ(frame.id, 0x8905U);
  frame = reply(5, 10, 0, 0, 0, 2, 0);
  frame.id |= 9;
  EXPECT_EQ(device_of(frame), 5U);
  EXPECT_EQ(source_of(frame), 9U);
  JointSample sample;
  EXPECT_TRUE(driver.decode(frame, sample));
}

TEST(MoteusDriver, AnotherDevicesOrHalfAnAnswerIsRefused) {
  const MoteusDrive driver({.id = 1, .joint = {}});
  JointSample sample;
  EXPECT_FALSE(driver.decode(reply(2, 10, 0, 0, 0, 2, 0), sample));
  for (std::uint8_t size = 0; size < 24; ++size) {
    Frame frame = reply(1, 10, 0, 0, 0, 2, 0);
    frame.size = size;
    EXPECT_FALSE(driver.decode(frame, sample)) << int(size);
  }
  EXPECT_FALSE(driver.decode(reply(1, 16, 0, 0, 0, 2, 0), sample)) << "there is no mode 16";
}

TEST(MoteusDriver, RandomBytesNeverPutAnImpossibleValueIntoASample) {
  const MoteusDrive driver({.id = 1, .joint = {}});
  std::mt19937_64 random(3);
  const Frame good = reply(1, 10, 0.25, 1, 0.1, 2, 0);
  int accepted = 0;
  for (int round = 0; round < 300'000; ++round) {
    Frame frame = good;
    const std::size_t changes = 1 + random() % 4;
    for (std::size_t i = 0; i < changes; ++i) frame.data[random() % 24] = static_cast<std::uint8_t>(random());
    if (round % 8 == 0) {
      for (std::uint8_t& byte : frame.data) byte = static_cast<std::uint8_t>(random());
      frame.size = static_cast<std::uint8_t>(random());
    }
    JointSample sample;
    if (!driver.decode(frame, sample)) continue;
    ++accepted;
    ASSERT_TRUE(std::isfinite(sample.position_rad) && std::abs(sample.position_rad) < 1e6);
    ASSERT_TRUE(std::isfinite(sample.velocity_rad_s) && std::abs(sample.velocity_rad_s) < 1e5);
    ASSERT_TRUE(std::isfinite(sample.torque_nm) && std::abs(sample.torque_nm) <= 1000);
    ASSERT_LE(mode_of(sample.status), Mode::brake);
  }
  EXPECT_GT(accepted, 0);
}

TEST(MoteusDriver, FormatsMakeFramesShorter) {
  JointCommand command = torque_command(0.625);
  command.target_rad = 0.5 * kTurn;
  command.target_rad_s = -kTurn;
  command.kp_nm_rad = 2 / kTurn;
  for (const auto& [format, in_drive, size] :
       {std::tuple{Format::int8, false, 32}, std::tuple{Format::int8, true, 20}, std::tuple{Format::int16, true, 24}}) {
    DriverParams params{.id = 1, .joint = {}};
    params.frames = {.command = format, .answer = format, .settings_in_drive = in_drive};
    Frame frame;
    EXPECT_TRUE(MoteusDrive(params).encode(command, 0, frame));
    EXPECT_EQ(frame.size, size);
    const auto r = written(frame);
    EXPECT_NEAR(r.at(reg::kCommandPosition), 0.5, 1e-4);
    EXPECT_NEAR(r.at(reg::kCommandVelocity), -1, 3e-4);
    EXPECT_NEAR(r.at(reg::kCommandTorque), format == Format::int8 ? 0.5 : 0.62, 1e-9);
    EXPECT_NEAR(r.at(reg::kKpScale), 0.5, 1.0 / 127);
    EXPECT_EQ(r.contains(reg::kWatchdog), !in_drive);
    if (!in_drive) EXPECT_NEAR(r.at(reg::kWatchdog), 0.1, 1e-9);
  }
}

TEST(MoteusDriver, APositionItsFormatCannotSayIsNotSent) {
  DriverParams params{.id = 1, .joint = {}};
  params.frames.command = Format::int16;
  const MoteusDrive driver(params);
  JointCommand command = torque_command(0.1);
  Frame frame;
  command.target_rad = 3.2 * kTurn;
  EXPECT_TRUE(driver.encode(command, 0, frame));
  command.target_rad = -3.3 * kTurn;
  EXPECT_FALSE(driver.encode(command, 0, frame));
  EXPECT_EQ(written(frame).at(reg::kMode), 12);
}

TEST(MoteusDriver, AnIntegerAtItsEndIsNoMeasurement) {
  DriverParams params{.id = 1, .joint = {}};
  params.frames.answer = Format::int16;
  const MoteusDrive driver(params);
  for (const double rev : {3.0, 4.0}) {
    Frame frame;
    frame.id = 0x100;
    SubframeWriter writer(frame);
    writer.reply(Format::int8, reg::kMode, std::array{10.0}, false);
    writer.reply(Format::int16, reg::kPosition, std::array{rev, 0.0, 0.0}, false);
    writer.reply(Format::int8, reg::kFault, std::array{0.0}, false);
    JointSample sample;
    EXPECT_TRUE(driver.decode(frame, sample));
    EXPECT_EQ(sample.measured, rev < 3.2);
  }
}

TEST(MoteusFaults, HaveNames) {
  EXPECT_STREQ(fault_name(0), "none");
  EXPECT_STREQ(fault_name(32), "calibration failed");
  EXPECT_STREQ(fault_name(50), "velocity error too large");
  EXPECT_STREQ(fault_name(38), "over-temperature");
  EXPECT_STREQ(fault_name(96), "velocity limit");
  EXPECT_STREQ(fault_name(105), "field weakening");
  for (const std::uint32_t code : {1U, 31U, 51U, 95U, 106U, 4'000'000'000U}) EXPECT_STREQ(fault_name(code), "unknown");
  EXPECT_TRUE(is_limit(102));
  EXPECT_FALSE(is_limit(50));
  EXPECT_STREQ(mode_name(Mode::timeout), "timeout");
  EXPECT_STREQ(mode_name(Mode::brake), "brake");
  EXPECT_STREQ(mode_name(static_cast<Mode>(16)), "unknown");
}

}  // namespace
}  // namespace lithe::hal::moteus
