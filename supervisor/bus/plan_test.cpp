// SPDX-License-Identifier: Apache-2.0
#include "supervisor/bus/plan.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <string>

#include "spine/robot/robot.hpp"
#include "supervisor/bus/advice.hpp"
#include "supervisor/bus/report.hpp"

namespace lithe::bus {
namespace {

using robot::BusKind;
using robot::DeviceKind;
using robot::RobotConfig;

std::size_t add_bus(RobotConfig& robot, BusKind kind = BusKind::socketcan) {
  robot::BusConfig bus;
  bus.name = "can" + std::to_string(robot.buses.size());
  bus.kind = kind;
  bus.connector = static_cast<std::uint32_t>(robot.buses.size() + 1);
  robot.buses.push_back(bus);
  return robot.buses.size() - 1;
}

robot::DeviceConfig& add(RobotConfig& robot, std::size_t bus, DeviceKind kind = DeviceKind::moteus) {
  robot::DeviceConfig device;
  device.bus = bus;
  device.kind = kind;
  device.id = 1;
  for (const auto& other : robot.devices) device.id += other.bus == bus ? 1 : 0;
  device.name = robot.buses[bus].name + "." + std::to_string(device.id);
  robot.devices.push_back(device);
  robot::JointConfig joint;
  joint.device = robot.devices.size() - 1;
  if (kind != DeviceKind::gateway) robot.joints.push_back(joint);
  return robot.devices.back();
}

RobotConfig moteus_robot(int drives, BusKind kind = BusKind::socketcan) {
  RobotConfig robot;
  robot.path = "r.toml";
  const std::size_t bus = add_bus(robot, kind);
  for (int i = 0; i < drives; ++i) add(robot, bus);
  return robot;
}

RobotConfig canopen_robot(int drives, double rate_hz) {
  RobotConfig robot;
  robot.rate_hz = rate_hz;
  const std::size_t bus = add_bus(robot);
  robot.buses[bus].data_bitrate = 0;
  for (int i = 0; i < drives; ++i) add(robot, bus, DeviceKind::cia402).mode = robot::DriveMode::position;
  return robot;
}

TEST(Plan, AMoteusCostsWhatItsRealFramesCost) {
  const Plan plan = bus::plan(moteus_robot(1), {});
  const DevicePlan& device = plan.buses[0].devices[0];
  ASSERT_EQ(device.traffic.size(), 2U);
  EXPECT_EQ(device.traffic[0].size, 48U);
  EXPECT_EQ(device.traffic[1].size, 24U);
  EXPECT_TRUE(device.traffic[0].extended);
  EXPECT_FALSE(device.traffic[1].extended) << "an id below 8 answers in short frames";
  EXPECT_NEAR(device.average_us, 223, 7) << "published for these lengths: 223, at most 251";
  EXPECT_NEAR(device.worst_us, 251, 1.5);
}

TEST(Plan, IdsAboveSevenCostTwentyMicroseconds) {
  RobotConfig robot = moteus_robot(1);
  const double low = bus::plan(robot, {}).buses[0].devices[0].average_us;
  robot.devices[0].id = 8;
  const double high = bus::plan(robot, {}).buses[0].devices[0].average_us;
  EXPECT_NEAR(high - low, 20, 3);
}

TEST(Plan, ThreeMoteusFitAtAKilohertzAndFourDoNot) {
  EXPECT_TRUE(bus::plan(moteus_robot(3), {}).fits);
  const Plan four = bus::plan(moteus_robot(4), {});
  EXPECT_FALSE(four.fits);
  EXPECT_NEAR(four.buses[0].load_worst, 1.0, 0.01);
  EXPECT_GT(four.highest_rate_hz, 700);
  EXPECT_TRUE(bus::plan(moteus_robot(4), {std::floor(four.highest_rate_hz)}).fits);
  EXPECT_FALSE(bus::plan(moteus_robot(4), {std::ceil(four.highest_rate_hz)}).fits);
}

TEST(Plan, CanopenDrivesTakeThePublishedTimes) {
  const Plan plan = bus::plan(canopen_robot(1, 1000), {});
  ASSERT_EQ(plan.buses[0].shared.size(), 2U);
  EXPECT_EQ(plan.buses[0].shared[0].worst_us, 55) << "SYNC";
  const std::vector<Traffic>& frames = plan.buses[0].devices[0].traffic;
  EXPECT_EQ(frames[0].size, 8U);
  EXPECT_EQ(frames[0].worst_us, 135);
  EXPECT_EQ(frames[2].size, 8U);
  EXPECT_EQ(frames[3].worst_us, 65) << "a heartbeat";
  EXPECT_EQ(frames[3].per_s, 10);
  EXPECT_NEAR(plan.buses[0].devices[0].worst_us, 270 + 95, 1) << "published without velocity: 270";
  EXPECT_TRUE(bus::plan(canopen_robot(2, 900), {}).fits);
  EXPECT_FALSE(bus::plan(canopen_robot(3, 1000), {}).fits);
  EXPECT_TRUE(bus::plan(canopen_robot(4, 500), {}).fits);
}

TEST(Plan, ARateDividerThinsOutTheLoadAndDrivesTakeTurns) {
  RobotConfig robot = moteus_robot(6);
  for (auto& device : robot.devices) device.rate_divider = 2;
  const Plan plan = bus::plan(robot, {});
  EXPECT_NEAR(plan.buses[0].load_worst, 0.75, 0.01);
  EXPECT_NEAR(plan.buses[0].cycle_us, 3 * 251 + 200, 5) << "three in one tick, three in the next";
  EXPECT_TRUE(plan.fits);
}

// One SYNC is for all of them: they speak seldom, but all in the same tick.
TEST(Plan, CanopenDrivesOfABusAreAskedTogether) {
  RobotConfig robot = canopen_robot(2, 900);
  const Plan often = bus::plan(robot, {});
  for (auto& device : robot.devices) device.rate_divider = 2;
  const Plan seldom = bus::plan(robot, {});
  EXPECT_NEAR(seldom.buses[0].load_worst, often.buses[0].load_worst / 2, 0.01);
  EXPECT_NEAR(seldom.buses[0].cycle_us, often.buses[0].cycle_us, 1);
}

TEST(Plan, ADriveWithoutAJointIsLeftAlone) {
  RobotConfig robot = moteus_robot(3);
  robot.joints.pop_back();
  EXPECT_EQ(bus::plan(robot, {}).buses[0].devices.size(), 2U);
}

TEST(Plan, AGatewayIsCountedThoughNobodyAsksIt) {
  RobotConfig robot = moteus_robot(2);
  const double before = bus::plan(robot, {}).buses[0].cycle_us;
  add(robot, 0, DeviceKind::gateway);
  const Plan plan = bus::plan(robot, {});
  ASSERT_EQ(plan.buses[0].devices.size(), 3U);
  EXPECT_EQ(plan.buses[0].devices[2].traffic[0].size, 48U);
  EXPECT_NEAR(plan.buses[0].cycle_us - before, 161 + 80, 2) << "both blocks may come in any tick";
  EXPECT_NEAR(plan.buses[0].load_worst, 0.50 + 0.24, 0.01);
  robot.devices[2].rate_divider = 4;
  EXPECT_NEAR(bus::plan(robot, {}).buses[0].load_worst, 0.50 + 0.24, 0.01) << "nobody asks it";
  add(robot, 0);
  const Plan full = bus::plan(robot, {});
  EXPECT_FALSE(full.fits);
  EXPECT_TRUE(bus::plan(robot, {std::floor(full.highest_rate_hz)}).fits) << full.highest_rate_hz;
  robot.buses[0].data_bitrate = 0;
  EXPECT_EQ(bus::plan(robot, {}).buses[0].devices.back().traffic[0].size, 8U);
}

TEST(Plan, SerialTextIsPlannedAtItsBaudRate) {
  RobotConfig robot = moteus_robot(1, BusKind::fdcanusb);
  robot.buses[0].path = "/dev/ttyACM0";
  EXPECT_TRUE(bus::plan(robot, {}).fits) << "USB has no bauds";
  robot.buses[0].path = "/dev/ttyAMA0";
  const Plan uart = bus::plan(robot, {});
  EXPECT_FALSE(uart.fits) << "a command of 48 bytes is a line of more than 100 characters";
  EXPECT_NEAR(uart.buses[0].text_load, 1000 * 118 * 10 / 921'600.0, 0.05);
  EXPECT_TRUE(bus::plan(robot, {0, 4'000'000}).fits);
  RobotConfig canopen = canopen_robot(1, 1000);
  canopen.buses[0].kind = BusKind::slcan;
  canopen.buses[0].path = "/dev/ttyUSB0";
  const Traffic& command = bus::plan(canopen, {}).buses[0].devices[0].traffic[0];
  EXPECT_EQ(command.text_out_bytes, 22) << "t, three digits, 8, sixteen digits, end";
}

// Twelve servos, 24 bytes there and 16 back, took 740 us with everything on a Raspberry Pi 3B+.
TEST(Plan, APi3hatIsLimitedByItsSpi) {
  RobotConfig robot;
  for (int i = 0; i < 5; ++i) add_bus(robot, BusKind::pi3hat);
  for (std::size_t i = 0; i < 12; ++i) add(robot, i % 5);
  const Plan plan = bus::plan(robot, {});
  ASSERT_EQ(plan.spi.size(), 3U);
  EXPECT_EQ(plan.spi[0].processor, "JC1+JC2");
  const Traffic& command = plan.buses[0].devices[0].traffic[0];
  const Traffic& answer = plan.buses[0].devices[0].traffic[1];
  EXPECT_NEAR(command.spi_us, 55, 1);
  EXPECT_NEAR(answer.spi_us, 33, 1);
  const double byte_us = 0.8;
  const double published_us = 12 * (command.spi_us - 24 * byte_us + answer.spi_us - 8 * byte_us);
  EXPECT_NEAR(published_us, 740, 0.05 * 740);
  EXPECT_FALSE(plan.fits) << "not at 1 kHz with these frames, however many buses";
  EXPECT_LT(plan.buses[0].load_worst, kFullLoad);
  EXPECT_TRUE(bus::plan(robot, {std::floor(plan.highest_rate_hz)}).fits);
}

TEST(Advice, AFittingRobotNeedsNone) {
  EXPECT_TRUE(advise(moteus_robot(3), {}).empty());
  EXPECT_TRUE(judge_for_run(moteus_robot(3)).text.empty());
}

TEST(Advice, AFullBusGivesADriveToOneWithRoom) {
  RobotConfig robot = moteus_robot(4);
  add(robot, add_bus(robot));
  const std::vector<std::string> advice = advise(robot, {});
  ASSERT_EQ(advice.size(), 2U);
  EXPECT_EQ(advice[0].rfind("move \"can0.", 0), 0U) << advice[0];
  EXPECT_NE(advice[0].find("from can0 to can1"), std::string::npos) << advice[0];
  EXPECT_EQ(advice[1].rfind("or leave all that and set rate_hz", 0), 0U) << advice[1];
}

TEST(Advice, AMovedDriveGetsAnIdThatIsFreeThere) {
  RobotConfig robot = moteus_robot(4);
  const std::size_t other = add_bus(robot);
  for (auto& device : robot.devices) device.id = 3;
  robot.devices.resize(4);
  add(robot, other).id = 3;
  EXPECT_NE(advise(robot, {})[0].find("there with id 1"), std::string::npos);
}

TEST(Advice, WithoutRoomElsewhereDrivesAreAskedLessOften) {
  RobotConfig robot = moteus_robot(5);
  const std::size_t classic = add_bus(robot);
  robot.buses[classic].data_bitrate = 0;  // no place for a moteus
  const std::vector<std::string> advice = advise(robot, {});
  ASSERT_FALSE(advice.empty());
  EXPECT_NE(advice[0].find("rate_divider = 2"), std::string::npos) << advice[0];
}

TEST(Advice, WhoDoesNotWaitForAnswersIsTold) {
  RobotConfig robot = moteus_robot(2);
  robot.buses[0].reply_wait_s = 0.0005;
  const std::vector<std::string> advice = advise(robot, {});
  ASSERT_EQ(advice.size(), 1U);
  EXPECT_NE(advice[0].find("reply_wait_s = 0.0005"), std::string::npos) << advice[0];
}

TEST(Advice, WhatIsSaidFits) {
  for (int drives = 4; drives <= 12; ++drives) {
    RobotConfig robot = moteus_robot(drives);
    ASSERT_FALSE(advise(robot, {}).empty()) << drives;
    const double highest_hz = bus::plan(robot, {}).highest_rate_hz;
    EXPECT_TRUE(bus::plan(robot, {std::floor(highest_hz / 10) * 10}).fits) << drives;
    for (auto& device : robot.devices) device.rate_divider = static_cast<std::uint32_t>(drives + 2) / 3;
    EXPECT_TRUE(bus::plan(robot, {}).fits) << drives;
  }
}

TEST(Advice, ThirtyTwoDrivesOnAFewBusesAreNoHardship) {
  RobotConfig robot = moteus_robot(0);
  for (int i = 0; i < 9; ++i) add_bus(robot);
  for (int i = 0; i < 32; ++i) add(robot, i < 20 ? 0 : static_cast<std::size_t>(1 + i % 9));
  const std::vector<std::string> advice = advise(robot, {});
  ASSERT_GT(advice.size(), 10U);
  EXPECT_EQ(advice[0].rfind("move ", 0), 0U) << advice[0];
}

TEST(Advice, ARunIsRefusedAboveAllTimeAndWarnedAboveFullLoad) {
  const Verdict refused = judge_for_run(moteus_robot(5));
  EXPECT_TRUE(refused.refuse);
  EXPECT_NE(refused.text.find("125 % busy at 1000 Hz"), std::string::npos) << refused.text;
  EXPECT_NE(refused.next.find("lithe bus plan r.toml"), std::string::npos) << refused.next;
  RobotConfig slower = moteus_robot(4);
  slower.rate_hz = 950;
  const Verdict warned = judge_for_run(slower);
  EXPECT_FALSE(warned.refuse);
  EXPECT_FALSE(warned.text.empty());
  EXPECT_TRUE(judge_for_run(moteus_robot(32, BusKind::loop)).text.empty()) << "a loop has all the time";
}

TEST(Plan, AsJsonItSaysWhatItIs) {
  RobotConfig robot = moteus_robot(3, BusKind::loop);
  add_bus(robot);
  const Json json = to_json(bus::plan(robot, {}), robot);
  EXPECT_TRUE(json["fits"].get<bool>());
  EXPECT_FALSE(json["buses"][0]["real"].get<bool>());
  EXPECT_EQ(json["buses"][0]["devices"].size(), 3U);
  EXPECT_EQ(json["buses"][0]["devices"][0]["frames"][0]["bytes"], 48);
  EXPECT_TRUE(json["buses"][1]["highest_rate_hz"].is_null()) << "an empty bus has no limit";
}

TEST(Plan, TheRobotsAtHandFit) {
  for (const char* name : {"arm", "quadruped", "frankenstein"}) {
    const auto robot = robot::load_robot(std::string(LITHE_ROBOTS) + "/" + name + ".toml");
    ASSERT_TRUE(robot) << robot.message();
    EXPECT_TRUE(bus::plan(*robot, {}).fits) << name;
  }
}

}  // namespace
}  // namespace lithe::bus
