// SPDX-License-Identifier: Apache-2.0
// The laws that come with LITHE, on the robots that do: all pass the trial, and by how much is printed.
// No sanitizer build makes this: none can live in the sandbox.
#include <gtest/gtest.h>

#include <cstdio>
#include <string>

#include "spine/core/test/emulation_rig.hpp"
#include "spine/law/tremor.hpp"
#include "spine/robot/robot.hpp"
#include "trial/zygote.hpp"

namespace lithe::trial {
namespace {

using nlohmann::json;

class Margins : public ::testing::TestWithParam<const char*> {};

TEST_P(Margins, EveryLawThatComesWithLithePasses) {
  if (const std::string why = test::why_no_trial(); !why.empty()) GTEST_SKIP() << why;
  const std::string file = GetParam();
  auto robot = robot::load_robot(LITHE_ROBOTS "/" + file);
  ASSERT_TRUE(robot) << robot.message();
  auto zygote = Zygote::make(LITHE_ROBOTS "/" + file, -1);
  if (!zygote && robot->plant.kind == robot::PlantKind::mujoco) GTEST_SKIP() << zygote.message();
  ASSERT_TRUE(zygote) << zygote.message();
  for (const char* object : {LAW_pd, LAW_gravity_pd, LAW_impedance, LAW_lqr, LAW_hold, LAW_constant_torque}) {
    constexpr int kTries = 20;  // while a busy machine gives it less than its box
    const json request = {{"verb", "try"}, {"object", object}, {"budget_ns", 300'000}, {"box_ms", 1000}};
    json reply = zygote->answer(request.dump());
    for (int i = 1; i < kTries && reply.value("starved", false); ++i) reply = zygote->answer(request.dump());
    ASSERT_FALSE(reply.value("starved", false)) << file << " " << object << ": " << reply.dump();
    const std::string law = std::string(object).substr(std::string(object).rfind("trial_law_") + 10);
    EXPECT_TRUE(reply["ok"].get<bool>()) << file << " " << law << ": " << reply.value("reason", "");
    for (const char* which : {"plain", "rough"}) {
      const json loop = reply["report"]["loop"], &run = which[0] == 'p' ? loop : loop["rough"];
      std::printf("%-18s %-20s %-5s chatter %5.1f Hz of %.0f, undamped swings %u of %u, error %.3f rad (alone %.3f)\n",
                  file.c_str(), law.c_str(), which, run.value("most_chatter_hz", 0.0), law::Tremor::kChatterHz,
                  run.value("most_swings", 0u), law::Tremor::kMostSwings, run.value("rms_error_rad", 0.0),
                  run["without_a_law"].value("rms_error_rad", 0.0));
      const bool follows = std::string(object) != LAW_hold && std::string(object) != LAW_constant_torque;
      if (follows) EXPECT_LT(run["rms_error_rad"].get<double>(), run["without_a_law"]["rms_error_rad"].get<double>());
    }
    for (const json& each : reply.value("warnings", json::array())) std::printf("  warning: %s\n", each.dump().c_str());
  }
}

INSTANTIATE_TEST_SUITE_P(Robots, Margins,
                         ::testing::Values("arm.toml", "arm8.toml", "arm32.toml", "chain.toml", "frankenstein.toml",
                                           "quadruped.toml"),
                         [](const auto& each) {
                           return std::string(each.param).substr(0, std::string(each.param).find('.'));
                         });

}  // namespace
}  // namespace lithe::trial
