// SPDX-License-Identifier: Apache-2.0
// The safe law alone, on the robots that come with LITHE and on some that must be refused.
#include "trial/simulation/simulated_run.hpp"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <map>
#include <random>
#include <regex>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "spine/robot/robot.hpp"

namespace lithe::trial {
namespace {

using Changes = std::vector<std::pair<std::string, std::string>>;

std::string arm_text(const Changes& changes) {
  std::ostringstream text;
  text << std::ifstream(LITHE_ROBOTS "/arm.toml").rdbuf();
  std::string arm = text.str();
  for (const auto& [key, value] : changes) {
    const std::size_t at = arm.find("\n" + key + " = ");
    EXPECT_NE(at, std::string::npos) << key;
    const std::size_t from = at + key.size() + 4, to = arm.find_first_of(" \n", from);
    arm.replace(from, to - from, value);
  }
  return arm;
}

// Read as a robot file: what its static checks refuse does not get here.
Result<robot::RobotConfig> read(const Changes& changes) { return robot::parse_robot(arm_text(changes), "arm.toml"); }

std::string run(const Changes& changes) {
  const auto robot = read(changes);
  EXPECT_TRUE(robot) << robot.message();
  const auto said = run_safe_law(*robot);
  EXPECT_TRUE(said) << said.message();
  return *said;
}

bool says(const std::string& text, const std::string& phrase) { return text.find(phrase) != std::string::npos; }

TEST(SafeLawRun, TheRobotsThatComeWithLitheAreStoppedByTheirSafeLaw) {
  for (const char* file :
       {"arm.toml", "arm8.toml", "arm32.toml", "chain.toml", "frankenstein.toml", "quadruped.toml"}) {
    const auto robot = robot::load_robot(std::string(LITHE_ROBOTS "/") + file);
    ASSERT_TRUE(robot) << robot.message();
    const auto said = run_safe_law(*robot);
    if (!said && robot->plant.kind == robot::PlantKind::mujoco) continue;
    ASSERT_TRUE(said) << said.message();
    EXPECT_EQ(*said, "") << file;
  }
}

// The file's own check passes: it believes an inertia_min_kg_m2 that its simulated joint does not have.
TEST(SafeLawRun, AGainThatShakesALighterJointThanDeclaredIsRefusedWithTheNumberThatWouldDo) {
  Changes light{{"safe_kd_nm_s_rad", "0.3"}, {"inertia_kg_m2", "3e-4"}};
  const std::string said = run(light);
  EXPECT_TRUE(says(said, "joint shoulder: safe_kd_nm_s_rad = 0.3 shakes it")) << said;
  EXPECT_TRUE(says(said, "are too many")) << said;
  ASSERT_TRUE(says(said, "write safe_kd_nm_s_rad = ")) << said;
  const std::size_t from = said.find("write safe_kd_nm_s_rad = ") + 25;
  light[0].second = said.substr(from, said.find(' ', from) - from);
  EXPECT_EQ(run(light), "") << light[0].second;
}

TEST(SafeLawRun, AGainThatStopsNothingIsRefused) {
  const Changes limp{{"safe_kd_nm_s_rad", "1e-6"},  {"safe_kp_nm_rad", "0"},     {"mgl_nm", "0"},
                     {"coulomb_nm", "0"},           {"stribeck_nm", "0"},        {"cogging_nm", "0"},
                     {"position_min_rad", "-3000"}, {"position_max_rad", "3000"}};
  const std::string said = run(limp);
  EXPECT_TRUE(says(said, "joint shoulder: safe_kd_nm_s_rad = 1e-06 does not slow it down")) << said;
  EXPECT_TRUE(says(said, "write safe_kd_nm_s_rad = ")) << said;
}

// A real joint of which nothing is declared is not judged by what was assumed.
TEST(SafeLawRun, ARealJointIsSimulatedAsItIsDeclaredAndNotAsItIsAssumed) {
  const Changes real{{"safe_kd_nm_s_rad", "0.3"}, {"inertia_kg_m2", "3e-4"}};
  std::string text = arm_text(real);
  text.replace(text.find("kind = \"loop\""), 13, "kind = \"socketcan\"\ninterface = \"can0\"");
  auto robot = robot::parse_robot(text, "arm.toml");
  ASSERT_TRUE(robot) << robot.message();
  EXPECT_EQ(*run_safe_law(*robot), "") << "its declared inertia counts, not that of a simulation";
  robot->joints[0].safe_kd_nm_s_rad = 0.95;
  EXPECT_NE(*run_safe_law(*robot), "");
  robot->joints[0].inertia_declared = false;
  EXPECT_EQ(*run_safe_law(*robot), "");
}

TEST(SafeLawRun, AJointThatIsNotJudgedHidesNoneThatShakes) {
  std::ostringstream text;
  text << std::ifstream(LITHE_ROBOTS "/arm8.toml").rdbuf();
  std::string arms = text.str();
  arms.replace(arms.find("kind = \"loop\""), 13, "kind = \"socketcan\"\ninterface = \"can0\"");
  auto robot = robot::parse_robot(arms, "arm8.toml");
  ASSERT_TRUE(robot) << robot.message();
  robot->joints[0].safe_kd_nm_s_rad = robot->joints[1].safe_kd_nm_s_rad = 0.95;
  robot->joints[0].inertia_declared = false;
  const std::string said = *run_safe_law(*robot);
  EXPECT_TRUE(says(said, "joint " + robot->joints[1].name + ": safe_kd_nm_s_rad = 0.95 shakes it")) << said;
}

// How far the check of the file and the run agree: where the simulation is what the file declares, no gain that the
// file's check lets pass shakes, for kd and the delay. Where it is lighter than declared, only the run finds out.
TEST(SafeLawRun, WhatTheFilesCheckLetsPassStopsWellWhereTheFileIsTrue) {
  double passes = 0, shakes = 0;
  for (double kd = 0.02; kd < 1; kd *= 1.25) {
    const std::string gain = std::to_string(kd);
    const auto robot = read({{"safe_kd_nm_s_rad", gain}});
    if (robot) {
      passes = kd;
      EXPECT_EQ(*run_safe_law(*robot), "") << kd;
    }
    auto anyway = read({});
    anyway->joints[0].safe_kd_nm_s_rad = kd;
    if (shakes == 0 && !run_safe_law(*anyway)->empty()) shakes = kd;
  }
  std::printf("safe_kd_nm_s_rad of the arm: the file's check lets %.3f pass, the run refuses from %.3f on (0: none)\n",
              passes, shakes);
  EXPECT_GT(passes, 0.3);
  EXPECT_TRUE(shakes == 0 || shakes > passes);
}

// A robot of one or two joints, and a person who does what each message says, word for word.
class Follower {
 public:
  explicit Follower(unsigned seed) : random_(seed) {
    for (const char* joint : {"a", "b"}) {
      const double torque_nm = log_between(0.2, 200), load_nm = torque_nm * log_between(0.01, 1.2);
      const double inertia = torque_nm / log_between(20, 300);
      values_[joint] = {{"ratio", std::max(1.0, torque_nm / 2) * log_between(1, 10)},
                        {"torque_max_nm", torque_nm},
                        {"torque_slew_nm_s", torque_nm * log_between(50, 500)},
                        {"velocity_max_rad_s", log_between(4, 40)},
                        {"position_min_rad", -log_between(0.5, 3)},
                        {"position_max_rad", log_between(0.5, 3)},
                        {"load_max_nm", load_nm},
                        {"inertia_max_kg_m2", inertia},
                        {"inertia_min_kg_m2", inertia * log_between(0.02, 1)},
                        {"kd_max_nm_s_rad", torque_nm},
                        {"kp_max_nm_rad", torque_nm * 10},
                        {"safe_kd_nm_s_rad", torque_nm * log_between(1e-3, 2)}};
    }
  }

  // What is said of the robot; "" when nothing is left to do.
  std::string said() const {
    const auto robot = robot::parse_robot(text(), "r.toml");
    if (!robot) return robot.message();
    const auto run = run_safe_law(*robot);
    EXPECT_TRUE(run) << run.message();
    std::string all = *run;
    for (const std::string& note : robot->notes) all += (all.empty() ? "" : "\n") + note;
    return all;
  }

  std::string text() const {
    std::string text = "name = \"r\"\n[[bus]]\nname = \"b\"\nkind = \"loop\"\n[defaults.device]\nkind = \"moteus\"\n";
    int id = 0;
    for (const auto& [name, keys] : values_) {
      text += "[[device]]\nname = \"d" + name + "\"\nbus = \"b\"\nid = " + std::to_string(++id) +
              "\n[[joint]]\nname = \"" + name + "\"\ndevice = \"d" + name + "\"\n";
      for (const auto& [key, value] : keys)
        if (key != kCounts) text += key + " = " + fmt::format("{}", value) + "\n";
      if (keys.contains(kCounts))
        text += "[joint.sim]\n" + kCounts + " = " + std::to_string(int(keys.at(kCounts))) + "\n";
    }
    return text;
  }

  // Of each line the first advice. False: a line has none.
  bool follow(const std::string& said) {
    static const std::regex joint("joint\\]\\] (\\w+)|joint \"?(\\w+)"), value("write (\\w+) = ([-+.e0-9]+)");
    std::istringstream lines(said);
    for (std::string line; std::getline(lines, line);) {
      std::smatch who, what;
      if (!std::regex_search(line, who, joint) || !std::regex_search(line, what, value)) return false;
      values_.at(who[1].matched ? who[1] : who[2])[what[1]] = std::stod(what[2]);
    }
    return true;
  }

 private:
  double log_between(double least, double most) {
    return least * std::pow(most / least, std::uniform_real_distribution<double>(0, 1)(random_));
  }

  static inline const std::string kCounts = "encoder_counts";
  std::mt19937 random_;
  std::map<std::string, std::map<std::string, double>> values_;
};

TEST(SafeLawRun, WhoFollowsTheMessagesWordForWordGetsARobotThatStarts) {
  constexpr unsigned kRobots = 50;
  constexpr int kMostStarts = 6;
  int refused = 0, longest = 0;
  for (unsigned seed = 1; seed <= kRobots; ++seed) {
    Follower person(seed);
    std::string said = person.said(), story;
    int starts = 1;
    for (; !said.empty() && starts < kMostStarts; ++starts) {
      story += said + "\n--\n";
      ASSERT_TRUE(person.follow(said)) << "seed " << seed << ": no advice in\n" << said << person.text();
      said = person.said();
    }
    EXPECT_EQ(said, "") << "seed " << seed << " after\n" << story;
    refused += starts > 1 ? 1 : 0;
    longest = std::max(longest, starts);
  }
  std::printf("of %u robots %d were not right at once; the most starts: %d\n", kRobots, refused, longest);
  EXPECT_GT(refused, 25);
}

}  // namespace
}  // namespace lithe::trial
