// SPDX-License-Identifier: Apache-2.0
#include "supervisor/bus/plan/plan.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <regex>
#include <set>
#include <string>
#include <utility>

#include "supervisor/bus/test/robots_rig.hpp"

namespace lithe::bus {
namespace {

using namespace test;

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

std::size_t bus_named(const RobotConfig& robot, const std::string& name) {
  std::size_t i = 0;
  while (i < robot.buses.size() && robot.buses[i].name != name) ++i;
  return i;
}

// Does what the sentence says, as a person would. False: it is no advice that can be followed.
bool follow(const std::string& sentence, RobotConfig& robot) {
  std::smatch found;
  if (std::regex_search(sentence, found,
                        std::regex("^move \"([^\"]+)\" from (\\w+) to (\\w+)(, there with id (\\d+))?"))) {
    for (robot::DeviceConfig& device : robot.devices) {
      if (device.name != found[1]) continue;
      EXPECT_EQ(device.bus, bus_named(robot, found[2]));
      device.bus = bus_named(robot, found[3]);
      if (found[5].matched) device.id = static_cast<std::uint32_t>(std::stoul(found[5]));
      return device.bus < robot.buses.size();
    }
    return false;
  }
  if (std::regex_search(sentence, found, std::regex("^ask (.*) less often: rate_divider = (\\d+)"))) {
    for (robot::DeviceConfig& device : robot.devices) {
      if (found[1].str().find('"' + device.name + '"') == std::string::npos) continue;
      device.rate_divider = static_cast<std::uint32_t>(std::stoul(found[2]));
    }
    return true;
  }
  if (std::regex_search(
          sentence, found,
          std::regex("^(lower|or leave all that and set) rate_hz (to|=) ([\\d.]+)(, with watchdog_s = ([\\d.]+))?"))) {
    robot.rate_hz = std::stod(found[3]);
    for (robot::DeviceConfig& device : robot.devices)
      if (found[5].matched) device.watchdog_s = std::max(device.watchdog_s, std::stod(found[5]));
    return true;
  }
  return false;
}

// As load_robot demands of what a person writes.
bool may_be_loaded(const RobotConfig& robot) {
  std::set<std::pair<std::size_t, std::uint32_t>> taken;
  bool sound = robot.rate_hz >= 100;
  for (const robot::DeviceConfig& device : robot.devices) {
    sound = sound && device.id >= 1 && device.id <= 126 && taken.insert({device.bus, device.id}).second;
    if (device.kind != DeviceKind::gateway)
      sound = sound && device.watchdog_s * robot.rate_hz / device.rate_divider >= 4;
  }
  return sound;
}

void expect_good_advice(const RobotConfig& robot, const std::string& name) {
  const std::vector<std::string> advice = advise(robot, {});
  ASSERT_FALSE(advice.empty()) << name;
  RobotConfig changed = robot;
  for (const std::string& each : advice) {
    if (each.rfind("or leave", 0) == 0) {
      RobotConfig slower = robot;
      EXPECT_TRUE(follow(each, slower)) << each;
      EXPECT_TRUE(bus::plan(slower, {}).fits && may_be_loaded(slower)) << name << ": " << each;
    } else if (each.find("reply_wait_s") == std::string::npos && each.rfind("no rate", 0) != 0) {
      EXPECT_TRUE(follow(each, changed)) << each;
    }
  }
  if (advice.back().rfind("no rate", 0) == 0) return;
  EXPECT_TRUE(bus::plan(changed, {}).fits && may_be_loaded(changed)) << name << ": " << advice.front();
}

TEST(Advice, WhoFollowsItHasARobotThatFitsAndLoads) {
  for (int drives = 4; drives <= 12; ++drives) {
    const std::string name = std::to_string(drives) + " drives";
    expect_good_advice(moteus_robot(drives), name);
    RobotConfig two = moteus_robot(drives);
    add(two, add_bus(two));
    expect_good_advice(two, name + ", another bus");
    RobotConfig hasty = moteus_robot(drives);
    for (auto& device : hasty.devices) device.watchdog_s = 0.005;
    expect_good_advice(hasty, name + ", short watchdogs");
    RobotConfig heard = moteus_robot(drives);
    add(heard, 0, DeviceKind::gateway);
    expect_good_advice(heard, name + " and a gateway");
    expect_good_advice(canopen_robot(drives, 1000), name + " on CANopen");
  }
  RobotConfig hat;
  for (int i = 0; i < 5; ++i) add_bus(hat, BusKind::pi3hat);
  for (std::size_t i = 0; i < 12; ++i) add(hat, i % 5);
  expect_good_advice(hat, "a pi3hat");
}

// The twin: a test that follows nothing, or believes anything, would not see bad advice.
TEST(Advice, BadAdviceWouldBeSeen) {
  RobotConfig robot = moteus_robot(5);
  RobotConfig wrong = robot;
  EXPECT_TRUE(follow("ask \"can0.1\" less often: rate_divider = 2; can0 125 -> 112 %", wrong));
  EXPECT_FALSE(bus::plan(wrong, {}).fits);
  EXPECT_FALSE(follow("move \"nobody\" from can0 to can1", wrong));
  EXPECT_FALSE(follow("be nice", wrong));
  wrong.rate_hz = 30;
  EXPECT_FALSE(may_be_loaded(wrong));
}

TEST(Advice, NothingMovesOutOfTheRealWorldNorOntoAFullBus) {
  RobotConfig robot = moteus_robot(4);
  add(robot, add_bus(robot, BusKind::loop));
  for (const std::string& each : advise(robot, {})) EXPECT_EQ(each.find("move "), std::string::npos) << each;
  RobotConfig crowded = moteus_robot(4);
  const std::size_t other = add_bus(crowded);
  for (int i = 0; i < 126; ++i) {
    add(crowded, other);
    crowded.joints.pop_back();  // it is there, and never asked
  }
  for (auto& device : crowded.devices) device.watchdog_s = 1;
  for (const std::string& each : advise(crowded, {})) EXPECT_EQ(each.find("move "), std::string::npos) << each;
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
  EXPECT_FALSE(judge_for_run(moteus_robot(4)).refuse) << "100.4 % with frames that never occur, 89 % with real ones";
  EXPECT_TRUE(judge_for_run(moteus_robot(32, BusKind::loop)).text.empty()) << "a loop has all the time";
  RobotConfig hasty = moteus_robot(3);
  hasty.buses[0].reply_wait_s = 0.0005;
  EXPECT_FALSE(judge_for_run(hasty).refuse);
  EXPECT_NE(judge_for_run(hasty).text.find("does not wait for"), std::string::npos) << judge_for_run(hasty).text;
}

}  // namespace
}  // namespace lithe::bus
