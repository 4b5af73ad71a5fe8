// SPDX-License-Identifier: Apache-2.0
#include "supervisor/bus/plan/plan.hpp"

#include <gtest/gtest.h>

#include <unistd.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <string>

#include "spine/robot/robot.hpp"
#include "supervisor/bus/test/robots_rig.hpp"

namespace lithe::bus {
namespace {

using namespace test;

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

// As in the paper: four devices on one bus of a pi3hat, 1 kHz.
TEST(Plan, FourMoteusFitAtAKilohertzWithWholeNumbersAndSettingsOfTheirOwn) {
  for (const BusKind kind : {BusKind::socketcan, BusKind::pi3hat}) {
    RobotConfig robot = moteus_robot(4, kind);
    ASSERT_FALSE(bus::plan(robot, {}).fits) << "with floats";
    for (robot::DeviceConfig& device : robot.devices) {
      device.keys.moteus.frames.command = device.keys.moteus.frames.answer = hal::moteus::Format::int16;
      device.keys.moteus.frames.settings_in_drive = true;
    }
    const Plan four = bus::plan(robot, {});
    EXPECT_EQ(four.buses[0].devices[0].traffic[0].size, 24U);
    EXPECT_EQ(four.buses[0].devices[0].traffic[1].size, 20U);
    EXPECT_TRUE(four.fits) << four.buses[0].load_worst;
    for (robot::DeviceConfig& device : robot.devices) device.keys.moteus.frames.current = hal::moteus::Format::int16;
    EXPECT_TRUE(bus::plan(robot, {}).fits) << "the current costs nothing then";
    for (robot::DeviceConfig& device : robot.devices) device.keys.moteus.frames.settings_in_drive = false;
    EXPECT_FALSE(bus::plan(robot, {}).fits) << "the settings in every command cost eleven bytes";
  }
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
  robot.buses[0].baud = 4'000'000;
  EXPECT_TRUE(bus::plan(robot, {}).fits) << "what the file says is what the line is set to";
  robot.buses[0].path = "/dev/serial/by-id/usb-FTDI_FT232R-if00-port0";
  EXPECT_EQ(bus::plan(robot, {}).buses[0].text_bytes_s, 400'000) << "who names a baud rate has one, whatever the path";
  robot.buses[0].baud = 0;
  EXPECT_EQ(bus::plan(robot, {}).buses[0].text_bytes_s, 1e6);
  RobotConfig canopen = canopen_robot(1, 1000);
  canopen.buses[0].kind = BusKind::slcan;
  canopen.buses[0].path = "/dev/ttyUSB0";
  const Traffic command = bus::plan(canopen, {}).buses[0].devices[0].traffic[0];
  EXPECT_EQ(command.text_out_bytes, 22) << "t, three digits, 8, sixteen digits, end";
}

// By what it leads to: links have any name.
TEST(Plan, APathIsFollowed) {
  const std::filesystem::path folder = testing::TempDir() + "lithe-plan-" + std::to_string(getpid());
  std::filesystem::create_directories(folder);
  std::ofstream(folder / "ttyUSB7").close();
  std::ofstream(folder / "pts7").close();
  std::filesystem::create_symlink(folder / "ttyUSB7", folder / "usb-FTDI-if00");
  std::filesystem::create_symlink(folder / "pts7", folder / "ttySim");
  RobotConfig robot = moteus_robot(1, BusKind::fdcanusb);
  robot.buses[0].path = folder / "usb-FTDI-if00";
  EXPECT_EQ(bus::plan(robot, {}).buses[0].text_bytes_s, 92'160);
  robot.buses[0].path = folder / "ttySim";
  EXPECT_EQ(bus::plan(robot, {}).buses[0].text_bytes_s, 1e6);
  std::filesystem::remove_all(folder);
}

TEST(Plan, ABusFullOfWhatNobodyAsksForFitsAtNoRate) {
  for (const int gateways : {4, 5}) {
    RobotConfig robot;
    const std::size_t bus = add_bus(robot);
    for (int i = 0; i < gateways; ++i) add(robot, bus, DeviceKind::gateway);
    add(robot, add_bus(robot));
    const Plan full = bus::plan(robot, {});
    EXPECT_FALSE(full.fits);
    EXPECT_EQ(full.buses[0].highest_rate_hz, 0) << gateways;
    for (const double rate_hz : {100.0, 1000.0, 5000.0}) EXPECT_FALSE(bus::plan(robot, {rate_hz}).fits);
    for (const std::string& each : advise(robot, {})) EXPECT_EQ(each.find("rate_hz"), std::string::npos) << each;
    const Verdict verdict = judge_for_run(robot);
    EXPECT_NE(verdict.text.find("no rate fits"), std::string::npos) << verdict.text;
    EXPECT_EQ(verdict.next.find("rate_hz"), std::string::npos) << verdict.next;
  }
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

TEST(Plan, AClassicConnectorMakesAPi3hatLookMoreOften) {
  RobotConfig robot;
  for (int i = 0; i < 5; ++i) add_bus(robot, BusKind::pi3hat);
  for (std::size_t i = 0; i < 4; ++i) add(robot, i);
  const double before_us = bus::plan(robot, {}).spi_us;
  robot.buses[4].data_bitrate = 0;
  EXPECT_NEAR(bus::plan(robot, {}).spi_us - before_us, 2 * 45, 1) << "two processors have devices";
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
