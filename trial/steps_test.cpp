// SPDX-License-Identifier: Apache-2.0
// Episodes on the robots that come with LITHE.
#include "trial/steps.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <fstream>
#include <memory>
#include <sstream>
#include <string>

#include "spine/robot/robot.hpp"
#include "trial/zygote.hpp"

namespace lithe::trial {
namespace {

using nlohmann::json;

class StepsTest : public ::testing::Test {
 protected:
  static std::unique_ptr<Steps> make(const std::string& file = "arm.toml") {
    auto made = Steps::make(LITHE_ROBOTS "/" + file);
    EXPECT_TRUE(made) << made.message();
    return std::move(*made);
  }
  json ask(const json& request) { return answer(request.dump()); }
  json answer(const std::string& line) { return steps_->answer(line); }
  json reset(const json& more = json::object()) {
    json request = {{"verb", "reset"}};
    request.update(more);
    return ask(request);
  }
  json step(double torque_nm) { return ask({{"verb", "step"}, {"torque_nm", {torque_nm}}}); }

  // The whole episode under a PD law, every observation in one line of text.
  std::string episode(const json& how) {
    std::string all;
    for (json seen = reset(how);; seen = step(pd_nm(seen))) {
      all += seen.dump();
      if (!seen["ok"].get<bool>() || seen["over"].get<bool>()) return all;
    }
  }
  static double of(const json& seen, const char* key) { return seen[key][0].get<double>(); }
  static double pd_nm(const json& seen) {
    return 4 * (of(seen, "setpoint_position_rad") - of(seen, "position_rad")) +
           0.1 * (of(seen, "setpoint_velocity_rad_s") - of(seen, "velocity_rad_s"));
  }

  std::unique_ptr<Steps> steps_ = make();
};

TEST_F(StepsTest, TheSameSeedAndTorquesGiveTheSameBits) {
  for (const bool rough : {false, true}) {
    const json how = {{"seed", 7}, {"rough", rough}, {"ticks", 3}, {"seconds", 0.3}};
    const std::string first = episode(how);
    EXPECT_EQ(episode(how), first);
    steps_ = make();
    EXPECT_EQ(episode(how), first) << "in another process, too";
    json other = how;
    other["seed"] = 8;
    EXPECT_NE(episode(other), first);
  }
}

// The very run that a trial has its laws in: what is learnt here counts there.
TEST_F(StepsTest, SeedZeroIsTheRunOfATrialWithoutALaw) {
  for (const bool rough : {false, true}) {
    auto robot = robot::load_robot(LITHE_ROBOTS "/arm.toml");
    ASSERT_TRUE(robot) << robot.message();
    robot->guard.soft_start_s = 0;
    robot::RobotConfig model = *robot;
    model.plant.ideal = true;
    SimulatedRobot simulated;
    ASSERT_TRUE(open_ready(rough ? with_payload(model) : model, simulated));
    SimulatedRun run(*robot, simulated, rough);
    NoTorque no_torque;
    json seen = reset({{"rough", rough}});
    while (run.stats.ticks < run.stats.whole_ticks) {
      ASSERT_TRUE(run.tick(no_torque));
      ASSERT_EQ(seen["tick"], run.stats.ticks);
      ASSERT_EQ(of(seen, "position_rad"), run.record().position_rad[0]);
      ASSERT_EQ(of(seen, "setpoint_position_rad"), run.record().setpoint_position_rad[0]);
      if (!seen["over"].get<bool>()) seen = step(0);
    }
    EXPECT_TRUE(seen["over"].get<bool>());
    EXPECT_EQ(seen["ended"], "");
  }
}

TEST_F(StepsTest, ASetpointLeadsToADistanceAndBackAndCanBeFollowed) {
  double least_rad = 0, most_rad = 0;
  for (int seed = 1; seed <= 8; ++seed) {
    json seen = reset({{"seed", seed}, {"ticks", 5}});
    const double from_rad = of(seen, "setpoint_position_rad");
    double worst_rad = 0;
    while (!seen["over"].get<bool>()) {
      seen = step(pd_nm(seen));
      const double setpoint_rad = of(seen, "setpoint_position_rad");
      least_rad = std::min(least_rad, setpoint_rad);
      most_rad = std::max(most_rad, setpoint_rad);
      worst_rad = std::max(worst_rad, std::abs(setpoint_rad - of(seen, "position_rad")));
    }
    EXPECT_EQ(seen["tick"], 1000);
    EXPECT_EQ(seen["ended"], "");
    EXPECT_LT(worst_rad, 0.2) << "seed " << seed;
    EXPECT_NEAR(of(seen, "setpoint_position_rad"), from_rad, 1e-3);
  }
  EXPECT_LT(least_rad, -0.5);
  EXPECT_GT(most_rad, 0.5);
}

TEST_F(StepsTest, TheGuardsLimitsAndItsStopAreTold) {
  json seen = reset({{"ticks", 20}});
  EXPECT_FALSE(seen["clamped"].get<bool>());
  seen = step(5.0);
  EXPECT_TRUE(seen["clamped"].get<bool>());
  EXPECT_LE(of(seen, "command_torque_nm"), 0.6);
  // The guard keeps a joint that only its torque drives inside its limits: this one is swung up first.
  reset({{"ticks", 1}, {"seconds", 60}});
  for (int i = 0; i < 60'000 && !seen["over"].get<bool>(); ++i) seen = step(i % 2 == 0 ? 0.6 : -0.6);
  EXPECT_EQ(seen["shakes"], "chatter: joint shoulder");
}

// Heavier than its motor can hold: it falls out of its limits.
TEST_F(StepsTest, AnEpisodeThatTheGuardEndedSaysWhyAndTakesNoMoreSteps) {
  std::ostringstream text;
  text << std::ifstream(LITHE_ROBOTS "/arm.toml").rdbuf();
  std::string arm = text.str();
  const auto change = [&arm](const std::string& from, const std::string& to) {
    ASSERT_NE(arm.find(from), std::string::npos) << from;
    arm.replace(arm.find(from), from.size(), to);
  };
  change("initial_position_rad = 0.0", "initial_position_rad = 1.5");
  change("position_min_rad = -3.0 ", "position_min_rad = 0.9 ");
  change("mgl_nm = 0.165", "mgl_nm = 1.2");
  change("law = \"../laws/pd.cpp\"", "");
  const std::string path = testing::TempDir() + "lithe_steps_" + std::to_string(getpid()) + ".toml";
  std::ofstream(path) << arm;
  auto made = Steps::make(path);
  ASSERT_TRUE(made) << made.message();
  steps_ = std::move(*made);
  json seen = reset({{"ticks", 1000}});
  seen = step(0);
  EXPECT_TRUE(seen["over"].get<bool>());
  EXPECT_NE(seen["ended"].get<std::string>().find("position_limit: joint shoulder"), std::string::npos) << seen;
  EXPECT_EQ(step(0)["reason"], "the episode is over: reset first");
  EXPECT_EQ(reset()["ended"], "");

  change("kind = \"loop\"", "kind = \"socketcan\"\ninterface = \"can0\"");
  std::ofstream(path) << arm;
  const auto real = Steps::make(path);
  std::remove(path.c_str());
  ASSERT_FALSE(real);
  EXPECT_NE(real.message().find("bus can0 is a real one"), std::string::npos) << real.message();
}

TEST_F(StepsTest, EveryKindOfRobotHasEpisodes) {
  for (const char* file : {"arm32.toml", "chain.toml", "frankenstein.toml"}) {
    steps_ = make(file);
    const json joints = ask({{"verb", "describe"}})["joints"];
    json seen = reset({{"seed", 3}, {"ticks", 300}});
    ASSERT_TRUE(seen["ok"].get<bool>()) << file << seen;
    const std::vector<double> from = seen["setpoint_position_rad"];
    seen = ask({{"verb", "step"}, {"torque_nm", std::vector<double>(joints.size(), 0.0)}});
    EXPECT_EQ(seen["position_rad"].size(), joints.size());
    if (seen["over"].get<bool>()) continue;
    const std::vector<double> to = seen["setpoint_position_rad"];
    for (std::size_t j = 0; j < to.size(); ++j) EXPECT_NE(from[j], to[j]) << file << joints[j];
  }
}

TEST_F(StepsTest, NonsenseIsRefusedWithTheReasonAndTheEpisodeGoesOn) {
  const auto reason = [this](const std::string& line) {
    const json reply = answer(line);
    EXPECT_FALSE(reply["ok"].get<bool>()) << line;
    return reply["reason"].get<std::string>();
  };
  EXPECT_EQ(reason(R"({"verb":"step","torque_nm":[0]})"), "no episode has begun: reset first");
  ASSERT_TRUE(reset()["ok"].get<bool>());
  for (const char* line : {"{", "[]", "\xff", R"({"verb":3})", R"({"verb":"dance"})"})
    EXPECT_NE(reason(line).find("one JSON object per line"), std::string::npos) << line;
  for (const char* line : {R"({"verb":"step"})", R"({"verb":"step","torque_nm":[]})",
                           R"({"verb":"step","torque_nm":[0,0]})", R"({"verb":"step","torque_nm":["a"]})"}) {
    EXPECT_NE(reason(line).find("a list of 1 numbers"), std::string::npos) << line;
  }
  EXPECT_NE(reason(R"({"verb":"step","torque_nm":[1e999]})").find("a number is finite"), std::string::npos);
  EXPECT_NE(reason(R"({"verb":"reset","seed":-1})").find("\"seed\" must be a number from 0"), std::string::npos);
  EXPECT_NE(reason(R"({"verb":"reset","ticks":0})").find("\"ticks\""), std::string::npos);
  EXPECT_NE(reason(R"({"verb":"reset","seconds":"long"})").find("not \"long\""), std::string::npos);
  EXPECT_NE(reason(R"({"verb":"reset","rough":1})").find("true or false"), std::string::npos);
  EXPECT_EQ(step(0)["tick"], 2);
  EXPECT_FALSE(Steps::make("/nowhere.toml"));
}

}  // namespace
}  // namespace lithe::trial
