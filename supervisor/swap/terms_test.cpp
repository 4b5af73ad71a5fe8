// SPDX-License-Identifier: Apache-2.0
#include "supervisor/swap/terms.hpp"

#include <gtest/gtest.h>

namespace lithe::swap {
namespace {

robot::RobotConfig arm() {
  robot::RobotConfig robot;
  robot.joints.resize(2);
  robot.joints[0].torque_max_nm = 2.0;
  robot.joints[1].torque_max_nm = 0.5;
  return robot;
}

const Terms kTerms = terms_of(arm(), 1000.0);

TEST(Terms, AreTheRobotsUnlessTheRequestSaysOtherwise) {
  EXPECT_DOUBLE_EQ(kTerms.budget_us, 300.0);
  EXPECT_DOUBLE_EQ(kTerms.shadow_tolerance_nm, 0.05);
  const auto read = read_terms({{"blend_s", 0.1}, {"probation_s", 0}, {"source", "x"}}, kTerms, 1000.0);
  ASSERT_TRUE(std::holds_alternative<Terms>(read));
  EXPECT_DOUBLE_EQ(std::get<Terms>(read).blend_s, 0.1);
  EXPECT_DOUBLE_EQ(std::get<Terms>(read).probation_s, 0.0);
  EXPECT_DOUBLE_EQ(std::get<Terms>(read).error_ratio, kTerms.error_ratio);
}

TEST(Terms, GoToTheSpineInTicksAndAShortTimeIsStillOne) {
  Terms terms = kTerms;
  terms.shadow_s = 2.0;
  terms.blend_s = 0.0001;
  wire::StageRequest request;
  put_terms(terms, 1000.0, request);
  EXPECT_EQ(request.shadow_ticks, 2000U);
  EXPECT_EQ(request.blend_ticks, 1U);
  EXPECT_EQ(request.probation_ticks, 1000U);
  EXPECT_EQ(request.budget_ns, 300'000U);
  EXPECT_DOUBLE_EQ(request.probation_error_ratio, 3.0);
}

TEST(Terms, WhatDoesNotFitIsRefusedByName) {
  const Json wrong[] = {{{"blend_s", -1}},      {{"blend_s", "20ms"}}, {{"probation_s", 61}},
                        {{"error_ratio", 0.5}}, {{"shadow_s", 1e9}},   {{"shadow_tolerance_nm", 0}},
                        {{"budget_us", 1001}},  {{"budget_us", 0}},    {{"box_ms", 1}}};
  for (const Json& args : wrong) {
    const auto read = read_terms(args, kTerms, 1000.0);
    ASSERT_TRUE(std::holds_alternative<Refusal>(read)) << args.dump();
    EXPECT_EQ(std::get<Refusal>(read).code, "usage");
    EXPECT_NE(std::get<Refusal>(read).message.find(args.begin().key()), std::string::npos);
  }
}

TEST(Terms, ZeroSwitchesOffWhatHasALeastValue) {
  const auto read = read_terms({{"error_ratio", 0}}, kTerms, 1000.0);
  ASSERT_TRUE(std::holds_alternative<Terms>(read));
  EXPECT_DOUBLE_EQ(std::get<Terms>(read).error_ratio, 0.0);
}

}  // namespace
}  // namespace lithe::swap
