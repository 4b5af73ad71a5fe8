// SPDX-License-Identifier: Apache-2.0
// A robot with a CiA 401 module: from its file to its sensors, beside a drive on the same bus; and what tools say of
// it.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "spine/core/test/units_rig.hpp"
#include "spine/hal/registry.hpp"
#include "spine/hal/sim/simulate.hpp"
#include "spine/robot/robot.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::hal {
namespace {

constexpr const char* kFile = LITHE_ROBOTS "/cia401.toml";

// The error of the robot file with this text changed; empty = none.
std::string error_of(const std::string& from, const std::string& to) {
  std::stringstream text;
  text << std::ifstream(kFile).rdbuf();
  std::string changed = text.str();
  const std::size_t at = changed.find(from);
  if (at == std::string::npos) return "no '" + from + "' in the file";
  changed.replace(at, from.size(), to);
  const auto* test = testing::UnitTest::GetInstance()->current_test_info();
  const std::string path = testing::TempDir() + "/" + test->name() + ".toml";
  changed.replace(changed.find("law = "), 1, "# l");
  std::ofstream(path) << changed;
  const auto robot = robot::load_robot(path);
  std::filesystem::remove(path);
  return robot ? "" : robot.message();
}

TEST(Cia401Robot, ItsInputsAreTheRobotsSensorsBesideADrive) {
  const auto config = robot::load_robot(kFile);
  ASSERT_TRUE(config) << config.message();
  auto opened = sim::open_actuators(*config);
  ASSERT_TRUE(opened) << opened.message();
  Actuators& actuators = **opened;
  ActuatorCommand command;
  ActuatorState state;
  command.joints = 1;
  double least = 1e9, most = -1e9;
  for (int i = 1; i <= 2000; ++i) {
    actuators.cycle(command, state, 1000 * kMs + i * kMs);
    if (i < 500) continue;
    ASSERT_TRUE(std::isfinite(state.sensor[0])) << i;
    ASSERT_TRUE(state.sensor[1] == 0 || state.sensor[1] == 1) << i;
    least = std::min(least, state.sensor[0]);
    most = std::max(most, state.sensor[0]);
  }
  EXPECT_EQ(state.sensors, 2U);
  EXPECT_NEAR(most, 12500, 100) << "1000 counts of 12.5";
  EXPECT_NEAR(least, -12500, 100);
  EXPECT_NE(state.status[0] & wire::joint_status::kFresh, 0U) << "the drive on its bus works";
  EXPECT_EQ(actuators.why_not_ready(), "");
  EXPECT_EQ(actuators.counters().stray, 0U);
  EXPECT_EQ(actuators.counters().malformed, 0U);
}

TEST(Cia401Robot, TheFileIsHeldToWhatTheModuleHas) {
  EXPECT_EQ(error_of("channel = 5", "channel = 4"), "");
  EXPECT_NE(error_of("channel = 5", "channel = 6").find("6 is more than a cia401 has: 0 to 5"), std::string::npos)
      << error_of("channel = 5", "channel = 6");
  EXPECT_NE(error_of("kind = \"analog\"", "kind = \"imu\"").find("kind = \"analog\" or \"digital\""),
            std::string::npos);
  EXPECT_NE(error_of("digital_inputs = 16", "digital_inputs = 17").find("digital_inputs"), std::string::npos);
  EXPECT_NE(error_of("send_every_s = 0.01", "send_every_s = 0.06").find("half of watchdog_s"), std::string::npos);
  EXPECT_NE(error_of("data_bitrate = 0",
                     "data_bitrate = 0\n[[device]]\nname = \"m\"\nkind = \"moteus\"\nbus = \"can\"\nid = 9")
                .find("carry the same ids"),
            std::string::npos);
  EXPECT_NE(error_of("device = \"boom_drive\"", "device = \"inputs\"").find("moves nothing"), std::string::npos);
}

TEST(Cia401Robot, TheTableTellsItsTrafficAndItsWords) {
  const auto config = robot::load_robot(kFile);
  ASSERT_TRUE(config) << config.message();
  const robot::DeviceConfig& device = config->devices[1];
  const DeviceType& type = type_of(device.kind);
  std::vector<std::pair<std::uint32_t, std::size_t>> frames;
  for (const PlannedFrame& each : type.frames(device, config->buses[0])) frames.emplace_back(each.id, each.size);
  const std::vector<std::pair<std::uint32_t, std::size_t>> expected{{0x183, 2}, {0x283, 8}, {0x383, 4}, {0x703, 1}};
  EXPECT_EQ(frames, expected);
  canopen::PdoMap map;
  ASSERT_TRUE(type.process_map(device, 0x383, map));
  EXPECT_EQ(type.process_value(map.objects()[1], 0xff88), "analog 5 -120");
  ASSERT_TRUE(type.process_map(device, 0x183, map));
  EXPECT_EQ(type.process_value(map.objects()[1], 0x05), "digital 8-15 00000101");
  EXPECT_FALSE(type.process_map(device, 0x483, map));
  EXPECT_EQ(type.object_name(0x6401), "analog inputs");
}

}  // namespace
}  // namespace lithe::hal
