// SPDX-License-Identifier: Apache-2.0
#include "supervisor/swap/tried_laws.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <string_view>

namespace lithe::control {
namespace {

using Words = std::vector<std::string>;

Json run(std::vector<double> plain_rad, std::vector<double> rough_rad, int ticks = 1000, int rough_ticks = 1000) {
  return {{"ticks", ticks},
          {"joint_rms_error_rad", std::move(plain_rad)},
          {"rough", {{"ticks", rough_ticks}, {"joint_rms_error_rad", std::move(rough_rad)}}}};
}

TEST(WorseJoints, AreNamedWithBothNumbersAndTheRun) {
  const Words found =
      worse_joints(run({0.1, 0.02}, {0.1, 0.2}), run({0.05, 0.02}, {0.1, 0.02}), "under pd", {"hip", "knee"});
  EXPECT_EQ(
      found,
      (Words{"joint hip follows its setpoint worse than under pd: 0.100 rad against 0.050 (rms), on the simulated "
             "robot",
             "joint knee follows its setpoint much worse than under pd: 0.200 rad against 0.020 (rms), in the "
             "rough run (pushed, 20 % heavier, noisy sensors, one tick later)"}));
}

TEST(WorseJoints, ALittleIsNotWorse) {
  EXPECT_TRUE(worse_joints(run({0.069}, {0.009}), run({0.05}, {0.0}), "", {"hip"}).empty());
  EXPECT_TRUE(worse_joints(run({0.01}, {0.01}), run({0.5}, {0.5}), "", {"hip"}).empty());
}

TEST(WorseJoints, RunsOfDifferentLengthAreNotCompared) {
  EXPECT_TRUE(worse_joints(run({0.5}, {0.0}, 400), run({0.0}, {0.0}), "", {"hip"}).empty());
  EXPECT_EQ(worse_joints(run({0.5}, {0.5}, 400), run({0.0}, {0.0}), "", {"hip"}).size(), 1U) << "but the other is";
  EXPECT_TRUE(worse_joints(nullptr, run({0.0}, {0.0}), "", {"hip"}).empty());
  EXPECT_TRUE(worse_joints(Json::object(), Json::object(), "", {"hip"}).empty());
}

TEST(MissingSensor, IsNamedWithThoseThatAreThereAndTheFile) {
  wire::RobotInfo info;
  const auto put = [](auto& field, std::size_t at, std::string_view text) {
    std::ranges::copy(text, field.begin() + static_cast<std::ptrdiff_t>(at));
  };
  put(info.config_path, 0, "hand.toml");
  EXPECT_EQ(
      missing_sensor({{"sensor", 0}}, info),
      "sensor = 0 is no sensor of this robot, which has none, so the law reacts to nothing: set one up as "
      "[[sensor]] in hand.toml (docs/hardware.md, Sensors), start the robot again, then lithe param set sensor 0");
  info.sensor_count = 2;
  put(info.sensor_name, 0, "heat");
  put(info.sensor_name, 32, "touch");
  EXPECT_EQ(missing_sensor({{"sensor", 2}}, info),
            "sensor = 2 is no sensor of this robot, so the law reacts to nothing: it has 0 heat, 1 touch: lithe param "
            "set sensor NUMBER; or set up another as [[sensor]] in hand.toml (docs/hardware.md, Sensors), and start "
            "the robot again");
  EXPECT_EQ(missing_sensor({{"sensor", -1}}, info).substr(0, 34), "sensor = -1 is no sensor of this r");
  EXPECT_EQ(missing_sensor({{"sensor", 1}}, info), "");
  EXPECT_EQ(missing_sensor({{"kp_nm_rad", 4}}, info), "") << "a law without that parameter";
}

}  // namespace
}  // namespace lithe::control
