// SPDX-License-Identifier: Apache-2.0
#include "supervisor/cli/robot/status_text.hpp"

#include <gtest/gtest.h>

#include <sstream>
#include <string>
#include <vector>

namespace lithe::cli {
namespace {

using control::Json;

std::vector<std::string> lines_of(const std::string& text) {
  std::vector<std::string> lines;
  std::istringstream in(text);
  for (std::string line; std::getline(in, line);) lines.push_back(line);
  return lines;
}

Json robot() {
  return {{"robot", "arm"},
          {"mode", "safe_stop"},
          {"fault", "velocity_limit"},
          {"alarms", Json::array({{{"level", "stop"}, {"text", "safe stop by velocity_limit"}},
                                  {{"level", "warn"}, {"text", "elbow is near its limit"}}})},
          {"joints", Json::array({{{"name", "elbow"},
                                   {"position_rad", 1.0},
                                   {"position_min_rad", -2.0},
                                   {"position_max_rad", 2.0},
                                   {"setpoint_position_rad", 0.5},
                                   {"velocity_rad_s", 0.1},
                                   {"torque_nm", 0.25},
                                   {"problems", Json::array({"lost"})},
                                   {"drive", "position timeout"},
                                   {"drive_state", "damped"}}})}};
}

TEST(StatusText, AlarmsComeFirst) {
  const auto lines = lines_of(status_text(robot(), {}));
  ASSERT_GE(lines.size(), 3u);
  EXPECT_EQ(lines[0], "robot arm: safe_stop, fault velocity_limit");
  EXPECT_EQ(lines[1], "  ALARM   safe stop by velocity_limit");
  EXPECT_EQ(lines[2], "  warning elbow is near its limit");
}

TEST(StatusText, JointsHaveAHeaderWithTheUnitThatIsAskedFor) {
  const std::string degrees = status_text(robot(), {}), radians = status_text(robot(), {false, true});
  for (const char* column : {"joint", "position", "setpoint", "velocity", "torque", "limits", "drive"})
    EXPECT_NE(degrees.find(column), std::string::npos) << column;
  EXPECT_NE(degrees.find("57.30"), std::string::npos) << degrees;
  EXPECT_NE(degrees.find("deg/s"), std::string::npos);
  EXPECT_NE(degrees.find("-114.59 .. 114.59"), std::string::npos);
  EXPECT_NE(radians.find("1.0000"), std::string::npos) << radians;
  EXPECT_NE(radians.find("rad/s"), std::string::npos);
  EXPECT_EQ(radians.find("deg"), std::string::npos) << radians;
  EXPECT_NE(degrees.find("damped lost (drive: position timeout)"), std::string::npos) << degrees;
}

TEST(StatusText, ColourIsForTerminalsOnly) {
  EXPECT_EQ(status_text(robot(), {}).find('\x1b'), std::string::npos);
  const std::string colored = status_text(robot(), {true, false});
  EXPECT_NE(colored.find("\x1b[1;31mALARM   safe stop by velocity_limit\x1b[0m"), std::string::npos) << colored;
  EXPECT_NE(colored.find("\x1b[33mwarning elbow"), std::string::npos);
  EXPECT_FALSE(wants_color()) << "a test's output is no terminal";
}

TEST(StatusText, InterruptsStandBelowTheCoreTheyMayLandOn) {
  Json status = robot();
  status["cpus"] = {{"spine", 1}, {"spine_core", {{"words", "isolated at boot (isolcpus)"}, {"why", "named"}}}};
  const std::string core = "  the Spine's core: 1, isolated at boot (isolcpus) (named)\n";
  EXPECT_NE(status_text(status, {}).find(core + "  Spine pid"), std::string::npos) << "an older supervisor";
  status["cpus"]["spine_core"]["interrupts"] = {{"count", 1}, {"words", "1 device interrupt may land there: 24 eth0"}};
  EXPECT_NE(status_text(status, {}).find(core + "    interrupts: 1 device interrupt may land there: 24 eth0\n"),
            std::string::npos)
      << status_text(status, {});
}

TEST(StatusText, AShieldIsToldWithWhatItCouldNotDo) {
  Json status = robot();
  EXPECT_EQ(status_text(status, {}).find("shield"), std::string::npos);
  status["shield"] = {{"words", "core 1, affinity: 59 tasks moved"}, {"notes", {"/proc/irq/36 stays 0-1"}}};
  const std::string text = status_text(status, {});
  EXPECT_NE(text.find("    shield: core 1, affinity: 59 tasks moved\n      /proc/irq/36 stays 0-1\n"),
            std::string::npos)
      << text;
}

TEST(StatusText, NothingIsNeeded) { EXPECT_NE(status_text(Json::object(), {}).find("robot -: -"), std::string::npos); }

}  // namespace
}  // namespace lithe::cli
