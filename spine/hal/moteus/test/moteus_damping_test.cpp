// SPDX-License-Identifier: Apache-2.0
// What a moteus is sent so that its joint is damped when nobody sends anything any more; and frames at their limits.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <map>
#include <random>

#include "spine/core/test/units_rig.hpp"
#include "spine/hal/moteus/moteus.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::hal::moteus::damping_test {
namespace {

std::map<std::uint32_t, double> written(const Frame& frame) {
  std::map<std::uint32_t, double> registers;
  SubframeReader reader(frame.payload());
  Subframe s;
  while (reader.next(s))
    for (std::uint32_t i = 0; s.kind == Kind::write && i < s.count; ++i) registers[s.start + i] = s.value(i);
  EXPECT_TRUE(reader.well_formed());
  return registers;
}

// What a drive with these gains does to the joint at this speed [Nm], as its firmware computes it.
double joint_nm(const std::map<std::uint32_t, double>& r, const DriverParams& params, double velocity_rad_s) {
  const double motor_rev_s = velocity_rad_s * params.joint.rev_per_rad();
  const double motor_nm = r.at(reg::kCommandTorque) +
                          r.at(reg::kKdScale) * params.kd_nm_s_rev * (r.at(reg::kCommandVelocity) - motor_rev_s);
  return motor_nm * params.joint.gear();
}

DriverParams damped(double sign = 1, double ratio = 1) {
  DriverParams params{.id = 1, .joint = {.sign = sign, .zero_rad = 0.3, .ratio = ratio}};
  params.damp_kd_nm_s_rad = 0.04;
  params.kd_nm_s_rev = 0.11;
  return params;
}

JointCommand torque_command(double torque_nm) {
  JointCommand command;
  command.action = DriveAction::torque;
  command.torque_nm = torque_nm;
  command.max_torque_nm = 0.6;
  return command;
}

TEST(MoteusDamping, ATorqueCommandCarriesItAndIsTheSameTorqueAtTheMeasuredSpeed) {
  for (const double sign : {1.0, -1.0}) {
    for (const double ratio : {1.0, 6.0}) {
      const DriverParams params = damped(sign, ratio);
      const MoteusDrive driver(params);
      for (const double speed : {-12.0, 0.0, 3.0}) {
        Frame frame;
        ASSERT_TRUE(driver.encode(torque_command(0.2), 0, frame, speed));
        const auto r = written(frame);
        EXPECT_NEAR(joint_nm(r, params, speed), 0.2, 1e-6);
        EXPECT_NEAR(joint_nm(r, params, speed + 1), 0.2 - 0.04, 1e-6) << "0.04 Nm per rad/s of the joint";
      }
    }
  }
}

TEST(MoteusDamping, ALawsOwnDampingCountsAndOnlyWhatIsMissingIsAdded) {
  const DriverParams params = damped();
  const MoteusDrive driver(params);
  JointCommand command = torque_command(0.1);
  command.target_rad_s = 2;
  command.kd_nm_s_rad = 0.03;
  Frame frame;
  driver.encode(command, 0, frame, 5);
  EXPECT_NEAR(joint_nm(written(frame), params, 5), 0.1 + 0.03 * (2 - 5), 1e-6);
  EXPECT_NEAR(written(frame).at(reg::kKdScale) * params.kd_nm_s_rev, 0.04 * kTurn, 1e-6);
  command.kd_nm_s_rad = 0.08;
  driver.encode(command, 0, frame, 5);
  EXPECT_NEAR(written(frame).at(reg::kCommandTorque), 0.1, 1e-6) << "it has enough";
  EXPECT_NEAR(written(frame).at(reg::kKdScale) * params.kd_nm_s_rev, 0.08 * kTurn, 1e-6);
}

TEST(MoteusDamping, ASpeedThatTheJointCannotHaveBecomesNoTorque) {
  DriverParams params = damped();
  params.velocity_max_rad_s = 30;
  const MoteusDrive driver(params);
  Frame frame;
  driver.encode(torque_command(0.1), 0, frame, 18'000);
  EXPECT_NEAR(written(frame).at(reg::kCommandTorque), 0.1 + 0.04 * 30, 1e-6);
}

TEST(MoteusDamping, DampSaysHowMuch) {
  DriverParams params = damped(-1, 6);
  JointCommand command;
  command.action = DriveAction::damp;
  Frame frame;
  MoteusDrive(params).encode(command, 0, frame);
  auto r = written(frame);
  EXPECT_EQ(r.at(reg::kMode), 12);
  EXPECT_NEAR(r.at(reg::kKdScale) * params.kd_nm_s_rev, 0.04 * kTurn / 36, 1e-6);
  EXPECT_FALSE(MoteusDrive(params).encode(torque_command(kNan), 0, frame));
  EXPECT_EQ(written(frame), r) << "nonsense is damped alike";
  params.damp_kd_nm_s_rad = 0;
  MoteusDrive(params).encode(command, 0, frame);
  EXPECT_EQ(written(frame).size(), 1U) << "as much as the drive has";
}

TEST(MoteusDriver, ARotorEncoderKnowsTheTurnOfADirectDriveOnly) {
  const auto homed = [](double home, double joint_ratio, double drive_ratio) {
    MoteusDrive driver({.id = 1, .joint = {.sign = 1, .zero_rad = 0, .ratio = joint_ratio}});
    driver.know({.kp_nm_rev = 4, .kd_nm_s_rev = 0.05, .rotor_to_output_ratio = drive_ratio});
    Frame frame;
    frame.id = 0x100;
    SubframeWriter writer(frame);
    writer.reply(Format::int8, reg::kMode, std::array{0.0}, false);
    writer.reply(Format::float32, reg::kPosition, std::array{0.0, 0.0, 0.0}, false);
    writer.reply(Format::int8, reg::kHomeState, std::array{home, 24.0, 25.0, 0.0}, true);
    JointSample sample;
    EXPECT_TRUE(driver.decode(frame, sample));
    return (sample.status & wire::joint_status::kNotHomed) == 0;
  };
  EXPECT_TRUE(homed(1, 1, 1));
  EXPECT_FALSE(homed(0, 1, 1));
  EXPECT_FALSE(homed(1, 6, 1)) << "a gear behind the drive";
  EXPECT_FALSE(homed(1, 1, 1.0 / 6)) << "a gear that the drive computes with: it reports turns of the output";
  EXPECT_FALSE(homed(1, 1, kNan)) << "nobody knows";
  EXPECT_TRUE(homed(2, 6, 1.0 / 6));
}

TEST(MoteusDriver, WhateverTheFormatsTheWorstFrameFits) {
  for (std::uint32_t choice = 0; choice < 1U << 11; ++choice) {
    const auto format = [choice](std::uint32_t bit) { return static_cast<Format>(choice >> bit & 3); };
    const auto or_none = [&](std::uint32_t bit) {
      return (choice >> bit & 1) != 0 ? std::optional(format(bit + 1)) : std::nullopt;
    };
    DriverParams params = damped();
    params.frames = {.command = format(0), .answer = format(2), .current = or_none(4), .power = or_none(7)};
    params.frames.settings_in_drive = (choice >> 10 & 1) != 0;
    const MoteusDrive driver(params);
    Frame frame;
    JointCommand command = torque_command(0.1);
    command.target_rad = 0.5;
    ASSERT_TRUE(driver.encode(command, 9, frame)) << choice;
  }
}

TEST(MoteusDriver, AFiniteNumberThatIsNoFloatNeverLeaves) {
  std::mt19937 random(5);
  for (double JointCommand::* field : std::initializer_list<double JointCommand::*>{
           &JointCommand::torque_nm, &JointCommand::target_rad_s, &JointCommand::kp_nm_rad, &JointCommand::kd_nm_s_rad,
           &JointCommand::max_torque_nm, &JointCommand::target_rad}) {
    for (const double huge : {1e300, -1e300, 1e38, 3e15}) {
      JointCommand command = torque_command(0.1);
      command.target_rad = 0;
      command.*field = huge;
      Frame frame;
      EXPECT_FALSE(MoteusDrive(damped()).encode(command, 0, frame));
      for (const auto& [number, value] : written(frame)) EXPECT_TRUE(std::isfinite(value)) << number;
    }
  }
  for (int round = 0; round < 10'000; ++round) {
    const auto some = [&random] { return std::pow(10.0, std::uniform_real_distribution(-15.0, 14.9)(random)); };
    JointCommand command = torque_command(some());
    command.target_rad = some();
    command.target_rad_s = -some();
    command.kp_nm_rad = some();
    command.kd_nm_s_rad = some();
    command.max_torque_nm = some();
    Frame frame;
    EXPECT_TRUE(MoteusDrive(damped(-1, 0.01)).encode(command, 0, frame, some()));
    for (const auto& [number, value] : written(frame)) ASSERT_TRUE(std::isfinite(value)) << number;
  }
}

TEST(MoteusDriver, AnIntegerAtItsEndIsNoSpeedAndNoTorque) {
  for (const auto& [format, velocity, torque, measured] :
       {std::tuple{Format::int16, 8.0, 300.0, true}, std::tuple{Format::int16, 12.0, 1.0, false},
        std::tuple{Format::int16, 1.0, 400.0, false}, std::tuple{Format::int8, 12.0, 60.0, true},
        std::tuple{Format::int8, 1.0, 90.0, false}}) {
    DriverParams params{.id = 1, .joint = {}};
    params.frames.answer = format;
    Frame frame;
    frame.id = 0x100;
    SubframeWriter writer(frame);
    writer.reply(Format::int8, reg::kMode, std::array{10.0}, false);
    writer.reply(format, reg::kPosition, std::array{0.1, velocity, torque}, false);
    writer.reply(Format::int8, reg::kFault, std::array{0.0}, false);
    JointSample sample;
    EXPECT_TRUE(MoteusDrive(params).decode(frame, sample));
    EXPECT_EQ(sample.measured, measured) << velocity << " " << torque;
  }
}

}  // namespace
}  // namespace lithe::hal::moteus::damping_test
