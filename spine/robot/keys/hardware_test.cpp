// SPDX-License-Identifier: Apache-2.0
// Buses, devices and sensors that do not fit together are refused; the message says what to do.
#include "spine/robot/keys/sections.hpp"

#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "spine/robot/robot.hpp"

namespace lithe::robot {
namespace {

const std::string kTop = "name = \"r\"\n";
const std::string kFd = "[[bus]]\nname = \"fd\"\nkind = \"socketcan\"\ninterface = \"can0\"\n";
const std::string kClassic = "[[bus]]\nname = \"classic\"\nkind = \"slcan\"\npath = \"/dev/ttyACM0\"\n";

std::string device(const std::string& name, const std::string& kind, const std::string& bus, int id,
                   const std::string& more = "") {
  return "[[device]]\nname = \"" + name + "\"\nkind = \"" + kind + "\"\nbus = \"" + bus +
         "\"\nid = " + std::to_string(id) + "\n" + more;
}
const std::string kRated = "rated_torque_nm = 0.5\n";

std::string joint(const std::string& name, const std::string& device) {
  return "[[joint]]\nname = \"" + name + "\"\ndevice = \"" + device +
         "\"\nposition_min_rad = -1\nposition_max_rad = 1\nvelocity_max_rad_s = 9\ntorque_max_nm = 1\n"
         "torque_slew_nm_s = 100\nsafe_kd_nm_s_rad = 0.1\nload_max_nm = 0.3\ninertia_max_kg_m2 = 5e-3\n";
}
std::string sensor(const std::string& name, const std::string& device, int channel) {
  return "[[sensor]]\nname = \"" + name + "\"\ndevice = \"" + device +
         "\"\nkind = \"analog\"\nchannel = " + std::to_string(channel) + "\nscale = 0.001\n";
}
const std::string kMixed = kTop + kFd + kClassic + device("m", "moteus", "fd", 1) +
                           device("g", "gateway", "classic", 9) +
                           device("c", "cia402", "classic", 2, kRated + "mode = \"position\"\nrate_divider = 2\n") +
                           joint("a", "m") + joint("b", "c") + sensor("pressure", "g", 3);

void expect_refused(const std::string& text, const std::vector<std::string>& phrases) {
  const Result<RobotConfig> robot = parse_robot(text, "r.toml");
  ASSERT_FALSE(robot) << "accepted, but should say: " << phrases.front();
  for (const std::string& phrase : phrases)
    EXPECT_NE(robot.message().find(phrase), std::string::npos) << robot.message() << "\nlacks: " << phrase;
}

TEST(Hardware, ARobotMixesBusesDevicesAndSensors) {
  const Result<RobotConfig> robot = parse_robot(kMixed, "r.toml");
  ASSERT_TRUE(robot) << robot.message();
  EXPECT_EQ(robot->buses[0].interface, "can0");
  EXPECT_EQ(robot->buses[0].data_bitrate, 5'000'000U);
  EXPECT_EQ(robot->buses[1].data_bitrate, 0U) << "an slcan adapter is classic unless it says otherwise";
  EXPECT_EQ(robot->devices[2].keys.cia402.mode, hal::cia402::Mode::position);
  EXPECT_EQ(robot->devices[2].rate_divider, 2U);
  ASSERT_EQ(robot->sensors.size(), 1U);
  EXPECT_EQ(robot->sensors[0].channel, 3U);
  EXPECT_EQ(robot->sensors[0].scale, 0.001);
  EXPECT_TRUE(robot->notes.empty()) << robot->notes.front();
}

TEST(Hardware, OnlyAMoteusMayHoldAloneAndOnlyWhereItSaysSo) {
  const auto parsed = [&](const std::string& more) {
    return parse_robot(kTop + kFd + device("d", "moteus", "fd", 1, more) + joint("j", "d"), "r.toml");
  };
  EXPECT_FALSE(parsed("")->devices[0].keys.moteus.may_hold_alone);
  EXPECT_TRUE(parsed("may_hold_alone = true\n")->devices[0].keys.moteus.may_hold_alone);
  expect_refused(
      kTop + kClassic + device("d", "cia402", "classic", 1, kRated + "may_hold_alone = true\n") + joint("j", "d"),
      {"may_hold_alone"});
}

TEST(Hardware, WhatABusNeedsToBeFoundIsAskedFor) {
  expect_refused(kTop + "[[bus]]\nname = \"b\"\nkind = \"fdcanusb\"\n", {"path"});
  expect_refused(kTop + "[[bus]]\nname = \"b\"\nkind = \"socketcan\"\n", {"interface"});
  expect_refused(kTop + "[[bus]]\nname = \"b\"\nkind = \"pi3hat\"\n", {"connector"});
  expect_refused(kTop + "[[bus]]\nname = \"b\"\nkind = \"loop\"\npath = \"/dev/x\"\n", {"path"});
  expect_refused(kTop + "[[bus]]\nname = \"b\"\nkind = \"can\"\n", {"socketcan"});
}

TEST(Hardware, ADeviceMustFitItsBus) {
  expect_refused(kTop + kClassic + device("m", "moteus", "classic", 1), {"classic CAN only", "data_bitrate"});
  expect_refused(
      kTop + "[[bus]]\nname = \"u\"\nkind = \"fdcanusb\"\npath = \"/dev/u\"\n" + device("c", "cia402", "u", 1, kRated),
      {"fdcanusb", "slcan or socketcan"});
  expect_refused(
      kTop + "[[bus]]\nname = \"h\"\nkind = \"pi3hat\"\nconnector = 3\n" + device("c", "cia402", "h", 1, kRated),
      {"classic CAN", "data_bitrate = 0"});
  expect_refused(kTop + kFd + device("m", "moteus", "fd", 1) + device("c", "cia402", "fd", 2, kRated),
                 {"\"m\" on it is a moteus, this is a cia402", "a bus each"});
  expect_refused(kTop + kFd + device("c", "cia402", "fd", 2), {"rated_torque_nm"});
  expect_refused(kTop + kFd + device("m", "moteus", "fd", 1, "rate_divider = 100\nwatchdog_s = 0.1\n"),
                 {"4 commands at 10 Hz", "0.4"});
}

TEST(Hardware, CanopenDrivesOfABusAreAskedTogether) {
  const std::string two = kTop + kClassic + device("c", "cia402", "classic", 1, kRated + "rate_divider = 2\n");
  EXPECT_TRUE(parse_robot(
      two + device("d", "cia402", "classic", 2, kRated + "rate_divider = 2\n") + joint("a", "c") + joint("b", "d"),
      "r.toml"));
  expect_refused(two + device("d", "cia402", "classic", 2, kRated), {"1 is not 2 as of \"c\"", "one SYNC"});
  EXPECT_TRUE(parse_robot(two + device("g", "gateway", "classic", 9) + joint("a", "c"), "r.toml"));
}

TEST(Hardware, WhatACanopenDriveCannotDoIsNotPromised) {
  const std::string torque = kTop + kClassic + device("c", "cia402", "classic", 1, kRated);
  const std::string position = kTop + kClassic + device("c", "cia402", "classic", 1, kRated + "mode = \"position\"\n");
  expect_refused(torque + joint("a", "c") + "must_be_homed = true\n", {"must_be_homed", "does not tell", "false"});
  EXPECT_TRUE(parse_robot(torque + joint("a", "c") + "must_be_homed = false\n", "r.toml"));
  EXPECT_TRUE(parse_robot(torque + joint("a", "c") + "power_max_w = 5\n", "r.toml"));
  expect_refused(position + joint("a", "c") + "power_max_w = 5\n", {"power_max_w", "mode = \"torque\""});
  EXPECT_TRUE(
      parse_robot(kTop + kFd + device("m", "moteus", "fd", 1) + joint("a", "m") + "must_be_homed = true\n", "r.toml"));
}

TEST(Hardware, TwoBusesAreNotOnePieceOfHardware) {
  const auto bus = [](const std::string& name, const std::string& words) {
    return "[[bus]]\nname = \"" + name + "\"\n" + words + "\n";
  };
  const std::string can = "kind = \"socketcan\"\ninterface = \"can0\"";
  expect_refused(kTop + bus("a", can) + bus("b", can), {"this is \"a\" already", "interface"});
  const std::string hat = "kind = \"pi3hat\"\nconnector = 3";
  expect_refused(kTop + bus("a", hat) + bus("b", hat), {"this is \"a\" already", "connector"});
  expect_refused(kTop + bus("a", "kind = \"slcan\"\npath = \"/dev/null\"") +
                     bus("b", "kind = \"fdcanusb\"\npath = \"/dev/../dev/null\""),
                 {"this is \"a\" already", "path"});
  const Result<RobotConfig> two =
      parse_robot(kTop + kFd + bus("b", "kind = \"socketcan\"\ninterface = \"can1\"") + bus("c", "kind = \"loop\"") +
                      bus("d", "kind = \"loop\"") + bus("e", hat) + device("m", "moteus", "fd", 1) + joint("j", "m"),
                  "r.toml");
  EXPECT_TRUE(two) << two.message();
}

TEST(Hardware, WhatAnAdapterIsNotToldIsRefused) {
  const std::string adapter = kTop + "[[bus]]\nname = \"b\"\nkind = \"fdcanusb\"\npath = \"/dev/x\"\n";
  expect_refused(adapter + "bitrate = 500000\n", {"its own memory"});
  expect_refused(adapter + "data_bitrate = 8000000\n", {"its own memory"});
  expect_refused(adapter + "data_bitrate = 0\n", {"its own memory"});
  expect_refused(adapter + "checksums = \"maybe\"\n", {"auto", "on", "off"});
  expect_refused(adapter + "baud = 1\n", {"baud"});
  expect_refused(kTop + kFd + "data_bitrate = 1\n", {"slower than bitrate"});
  expect_refused(kTop + kFd + "baud = 921600\n", {"'baud' is no key"});
  const Result<RobotConfig> robot = parse_robot(
      adapter + "baud = 2000000\nchecksums = \"off\"\n" + device("m", "moteus", "b", 1) + joint("j", "m"), "r.toml");
  ASSERT_TRUE(robot) << robot.message();
  EXPECT_EQ(robot->buses[0].baud, 2'000'000U);
  EXPECT_EQ(robot->buses[0].keys.fdcanusb.checksums, hal::Checksums::off);
}

TEST(Hardware, WaitingForOneDriveMustNotStopTheOthers) {
  const std::string ones = device("m", "moteus", "fd", 1) + joint("j", "m");
  const Result<RobotConfig> usual = parse_robot(kTop + kFd + ones, "r.toml");
  ASSERT_TRUE(usual) << usual.message();
  EXPECT_LT(usual->buses[0].reply_wait_s, 1e-3) << "one lost frame does not cost the next tick as well";
  const Result<RobotConfig> slow = parse_robot(kTop + "rate_hz = 200\n" + kFd + ones, "r.toml");
  ASSERT_TRUE(slow) << slow.message();
  EXPECT_EQ(slow->buses[0].reply_wait_s, 0.002);
  expect_refused(kTop + kFd + "reply_wait_s = 0.03\n" + ones, {"20 late ticks", "0.02"});
  expect_refused(kTop + kFd + "reply_wait_s = 0.01\n" +
                     device("m", "moteus", "fd", 1, "rate_divider = 8\nwatchdog_s = 0.1\n") + joint("j", "m"),
                 {"less than two commands", "0.16"});
}

TEST(Hardware, AJointIsNotPromisedWhatItsDriveCannotGive) {
  const std::string drive =
      kTop + kClassic + device("c", "cia402", "classic", 2, kRated + "counts_per_rev = 16777216\n");
  EXPECT_TRUE(parse_robot(drive + joint("j", "c"), "r.toml"));
  expect_refused(drive + joint("j", "c") + "must_be_homed = true\n", {"does not tell whether it is homed"});
  expect_refused(drive + joint("j", "c") + "ratio = 900\n", {"2.4e+09 counts", "608Fh"});
  expect_refused(drive + joint("j", "c") + "ratio = 400\nzero_rad = 2\n", {"counts of \"c\""});
  EXPECT_TRUE(
      parse_robot(kTop + kFd + device("m", "moteus", "fd", 1) + joint("j", "m") + "must_be_homed = true\n", "r.toml"));
}

TEST(Hardware, NobodyAsksAGateway) {
  const std::string rest = kFd + device("m", "moteus", "fd", 1) + joint("j", "m");
  expect_refused(kTop + rest + device("g", "gateway", "fd", 9, "rate_divider = 2\n"), {"rate_divider", "not asked"});
  const Result<RobotConfig> robot = parse_robot(
      kTop + "[defaults.device]\nrate_divider = 20\n" + rest + device("g", "gateway", "fd", 9, "watchdog_s = 0.01\n"),
      "r.toml");
  ASSERT_TRUE(robot) << robot.message();
  EXPECT_EQ(robot->devices[0].rate_divider, 20U);
  EXPECT_EQ(robot->devices[1].rate_divider, 1U);
}

TEST(Hardware, ASensorNeedsAChannelOfItsOwnOnAGateway) {
  const std::string base =
      kTop + kFd + device("m", "moteus", "fd", 1) + device("g", "gateway", "fd", 9) + joint("a", "m");
  EXPECT_TRUE(parse_robot(base + sensor("s", "g", 0), "r.toml"));
  expect_refused(base + sensor("s", "m", 0), {"\"m\" is a moteus", "gateway"});
  expect_refused(base + sensor("s", "g", 4) + sensor("t", "g", 4), {"4 is \"s\" already"});
  expect_refused(base + sensor("s", "g", 16), {"channel"});
  std::string imu = base + sensor("s", "g", 10);
  imu.replace(imu.find("analog"), 6, "imu");
  expect_refused(imu, {"10 is more than an IMU has: 0 to 9"});
  expect_refused(base + joint("b", "g"), {"\"g\" is a gateway and moves nothing"});
  std::string many = base;
  for (int i = 0; i < 2; ++i) many += device("g" + std::to_string(i), "gateway", "fd", 20 + i);
  for (int i = 0; i < 33; ++i) many += sensor("s" + std::to_string(i), i < 16 ? "g" : i < 32 ? "g0" : "g1", i % 16);
  expect_refused(many, {"33 sensors, LITHE carries 16"});
}

const std::string kHat = "[[bus]]\nname = \"jc1\"\nkind = \"pi3hat\"\nconnector = 1\n";
const std::string kImu = "[[device]]\nname = \"body\"\nkind = \"imu\"\nbus = \"jc1\"\n";

std::string imu_sensor(const std::string& kind, int channel) {
  return "[[sensor]]\nname = \"s\"\ndevice = \"body\"\nkind = \"" + kind + "\"\nchannel = " + std::to_string(channel) +
         "\n";
}

TEST(Hardware, AnImuIsOfTheBoardAndHasNoId) {
  const std::string drive = device("m", "moteus", "jc1", 1) + joint("a", "m");
  const Result<RobotConfig> robot = parse_robot(kTop + kHat + kImu + drive + imu_sensor("imu", 9), "r.toml");
  ASSERT_TRUE(robot) << robot.message();
  EXPECT_EQ(robot->devices[0].kind, DeviceKind::imu);
  EXPECT_TRUE(robot->notes.empty()) << robot->notes.front();
  expect_refused(kTop + kHat + kImu + drive + imu_sensor("imu", 10), {"10 is more than an IMU has: 0 to 9"});
  expect_refused(kTop + kHat + kImu + drive + imu_sensor("analog", 0), {"has kind = \"imu\""});
  expect_refused(kTop + kHat + kImu + drive + joint("b", "body"), {"is an imu and moves nothing"});
  expect_refused(kTop + kHat + kImu + "id = 3\n" + drive, {"id"});
  expect_refused(kTop + kFd + device("m", "moteus", "fd", 1) + joint("a", "m") +
                     "[[device]]\nname = \"body\"\nkind = \"imu\"\nbus = \"fd\"\n",
                 {"name a bus of the pi3hat"});
}

std::string framed(const std::string& frames, const std::string& more = "") {
  return kTop + kFd + device("m", "moteus", "fd", 1, more + "[device.frames]\n" + frames) + joint("a", "m");
}

TEST(Hardware, FormatsOfAMoteusAreReadAndDefaultsHoldForAll) {
  const std::string text = kTop + kFd + "[defaults.device.frames]\ncommand = \"int16\"\nsettings = \"drive\"\n" +
                           device("m", "moteus", "fd", 1, "[device.frames]\nanswer = \"int32\"\ncurrent = \"int8\"\n") +
                           joint("a", "m");
  const Result<RobotConfig> robot = parse_robot(text, "r.toml");
  ASSERT_TRUE(robot) << robot.message();
  const hal::moteus::FrameKeys& frames = robot->devices[0].keys.moteus.frames;
  EXPECT_EQ(frames.command, hal::moteus::Format::int16);
  EXPECT_EQ(frames.answer, hal::moteus::Format::int32);
  EXPECT_EQ(frames.current, hal::moteus::Format::int8);
  EXPECT_EQ(frames.power, std::nullopt);
  EXPECT_TRUE(frames.settings_in_drive);
}

TEST(Hardware, FormatsThatCannotSayTheJointsNumbersAreRefusedWithTheNumber) {
  const std::string both = "command = \"int16\"\nanswer = \"int16\"\n";
  EXPECT_TRUE(parse_robot(framed(both), "r.toml"));
  const std::string geared = framed(both) + "ratio = 30\n";
  expect_refused(geared,
                 {"position_max_rad", "needs 5.73 turns of the motor", "int16 of \"m\" ends at 3.277", "float"});
  expect_refused(geared, {"velocity_max_rad_s", "ends at 8.192"});
  expect_refused(kTop + kFd + device("g", "gateway", "fd", 9, "[device.frames]\n") + device("m", "moteus", "fd", 1) +
                     joint("a", "m"),
                 {"frames", "only the numbers of a moteus"});
  expect_refused(framed("command = \"none\"\n"), {"command", "int16"});
}

}  // namespace
}  // namespace lithe::robot
