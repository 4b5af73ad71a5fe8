// SPDX-License-Identifier: Apache-2.0
// Load and inertia in a robot file, and limits that cannot be kept.
#include "spine/robot/limits/limits.hpp"

#include <gtest/gtest.h>

#include <string>

#include "spine/robot/limits/stopping.hpp"
#include "spine/robot/robot.hpp"

namespace lithe::robot {
namespace {

const std::string kBus = "name = \"r\"\n[[bus]]\nname = \"b\"\n";
const std::string kSimulated = kBus + "kind = \"loop\"\n";
const std::string kReal = kBus + "kind = \"socketcan\"\ninterface = \"can0\"\n";
const std::string kDrive = "[[device]]\nname = \"d\"\nkind = \"moteus\"\nbus = \"b\"\nid = 1\n";
const std::string kArm =
    "[[joint]]\nname = \"j\"\ndevice = \"d\"\nposition_min_rad = -3\nposition_max_rad = 3\nvelocity_max_rad_s = 30\n"
    "torque_max_nm = 0.6\ntorque_slew_nm_s = 120\n";
const std::string kDamped = "safe_kd_nm_s_rad = 0.04\n";
const std::string kKnown = "load_max_nm = 0.165\ninertia_max_kg_m2 = 2.55e-3\n";
const std::string kSim = "[joint.sim]\ninertia_kg_m2 = 2.55e-3\nmgl_nm = 0.165\n";

RobotConfig parsed(const std::string& text) {
  Result<RobotConfig> robot = parse_robot(text, "r.toml");
  EXPECT_TRUE(robot) << robot.message();
  return robot ? *robot : RobotConfig{};
}
std::string mistake(const std::string& text) {
  const Result<RobotConfig> robot = parse_robot(text, "r.toml");
  return robot ? "none" : robot.message();
}
bool says(const std::string& text, const std::string& phrase) { return text.find(phrase) != std::string::npos; }

TEST(Limits, WhatIsDeclaredCounts) {
  const RobotConfig robot = parsed(kReal + kDrive + kArm + kDamped + kKnown + "inertia_min_kg_m2 = 1e-3\n");
  EXPECT_EQ(robot.joints.at(0).load_max_nm, 0.165);
  EXPECT_EQ(robot.joints[0].inertia_max_kg_m2, 2.55e-3);
  EXPECT_EQ(robot.joints[0].inertia_min_kg_m2, 1e-3);
  EXPECT_TRUE(robot.notes.empty()) << robot.notes[0];
}

TEST(Limits, ASimulatedJointIsTakenFromItsSimulationWithAMargin) {
  const RobotConfig robot = parsed(kSimulated + kDrive + kArm + kDamped + kSim);
  EXPECT_NEAR(robot.joints.at(0).load_max_nm, 1.25 * 0.165 + 0.03, 1e-9);
  EXPECT_NEAR(robot.joints[0].inertia_max_kg_m2, 1.25 * 2.55e-3, 1e-9);
  EXPECT_NEAR(robot.joints[0].inertia_min_kg_m2, 2.55e-3 / 1.25, 1e-9);
  EXPECT_TRUE(robot.notes.empty()) << robot.notes[0];
}

TEST(Limits, ARealJointThatSaysNothingIsReckonedCarefullyAndTold) {
  const RobotConfig robot = parsed(kReal + kDrive + kArm + kDamped + kSim);
  EXPECT_EQ(robot.joints.at(0).load_max_nm, 0.3);
  EXPECT_NEAR(robot.joints[0].inertia_max_kg_m2, 0.3 / 20, 1e-9);
  ASSERT_FALSE(robot.notes.empty());
  EXPECT_TRUE(says(robot.notes[0], "does not say load_max_nm and inertia_max_kg_m2")) << robot.notes[0];
  EXPECT_TRUE(says(robot.notes[0], "load_max_nm = 0.3")) << robot.notes[0];
}

TEST(Limits, ALoadThatLeavesNothingToBrakeWithIsRefused) {
  const std::string message = mistake(kReal + kDrive + kArm + kDamped + "load_max_nm = 0.59\n");
  EXPECT_TRUE(says(message, "load_max_nm")) << message;
  EXPECT_TRUE(says(message, "write torque_max_nm = 0.66 or more")) << message;
}

TEST(Limits, ARangeTooShortToStopInIsToldWithTheSpeedThatCanBeKept) {
  std::string text = kSimulated + kDrive + kArm + kDamped + kKnown;
  text.replace(text.find("position_max_rad = 3"), 20, "position_max_rad = -1");
  const RobotConfig robot = parsed(text);
  ASSERT_EQ(robot.notes.size(), 2U) << "and it starts outside";
  EXPECT_TRUE(says(robot.notes[0], "needs 3.596 rad to stop")) << robot.notes[0];
  const std::size_t advice = robot.notes[0].find("write velocity_max_rad_s = ");
  ASSERT_NE(advice, std::string::npos) << robot.notes[0];
  const std::string most = robot.notes[0].substr(advice + 27, robot.notes[0].find(' ', advice + 27) - advice - 27);
  text.replace(text.find("velocity_max_rad_s = 30"), 23, "velocity_max_rad_s = " + most);
  EXPECT_EQ(parsed(text).notes.size(), 1U) << "with " << most << " it can be kept";
}

TEST(Limits, SafeGainsThatShakeTheJointAreRefusedWithTheNumberThatWouldDo) {
  std::string shaking = kSimulated + kDrive + kArm + "safe_kd_nm_s_rad = 2\n" + kKnown;
  std::string message = mistake(shaking);
  EXPECT_TRUE(says(message, "safe_kd_nm_s_rad: 2 shakes a joint")) << message;
  const std::size_t advice = message.find("write safe_kd_nm_s_rad = ") + 25;
  const std::string most = message.substr(advice, message.find(' ', advice) - advice);
  shaking.replace(shaking.find("= 2\n"), 4, "= " + most + "\n");
  EXPECT_EQ(mistake(shaking), "none") << most;

  message = mistake(kSimulated + kDrive + kArm + kDamped + kKnown + "safe_kp_nm_rad = 20\n");
  EXPECT_TRUE(says(message, "safe_kp_nm_rad: 20 with safe_kd_nm_s_rad = 0.04 shakes")) << message;
}

TEST(Limits, SafeGainsAreNoMoreThanADriveMayBeGiven) {
  const std::string gains = kArm + "safe_kd_nm_s_rad = 0.2\nkd_max_nm_s_rad = 0.1\n";
  // The last one: a real joint of which nothing is known.
  for (const std::string& robot : {kSimulated + kDrive + gains + kKnown, kReal + kDrive + gains}) {
    const std::string message = mistake(robot);
    EXPECT_TRUE(says(message, "0.2 is more than kd_max_nm_s_rad = 0.1")) << message;
  }
}

TEST(Limits, ADriveThatIsAskedTooSeldomIsTold) {
  const std::string head = "rate_hz = 400\n" + kReal, divided = kDrive + "rate_divider = 2\n";
  EXPECT_TRUE(parsed(head + kDrive + kArm + kDamped + kKnown).notes.empty());
  const RobotConfig slow = parsed(head + divided + kArm + kDamped + kKnown);
  ASSERT_FALSE(slow.notes.empty());
  EXPECT_TRUE(says(slow.notes.back(), "200 times a second; below 250")) << slow.notes.back();
}

// A simulation of the joint with sampling and delay: it is stable where the formula says so, and its oscillation grows
// where the formula finds no margin left.
double swing(double inertia, double kp, double kd, int late_ticks) {
  constexpr double kTickS = 1e-3;
  double x = 0.01, v = 0.1;
  std::vector<double> torque(static_cast<std::size_t>(late_ticks) + 1, 0.0);
  double largest = 0;
  for (int i = 0; i < 4000; ++i) {
    torque.push_back(-kp * x - kd * v);
    const double now = torque[torque.size() - 1 - static_cast<std::size_t>(late_ticks)];
    x += v * kTickS + 0.5 * now / inertia * kTickS * kTickS;
    v += now / inertia * kTickS;
    if (i > 3000) largest = std::max(largest, std::abs(v));
  }
  return largest;
}

TEST(Limits, TheFormulaOfThePhaseMarginIsTheMotion) {
  constexpr double kInertia = 2.55e-3;
  for (const int late : {1, 3, 5}) {
    const double delay_s = 1e-3 * (late + 0.5);
    for (const double kp : {0.0, 0.5, 2.0}) {
      for (double kd = 0.01; kd < 2; kd *= 1.1) {
        const double margin = phase_margin_rad(kInertia, kp, kd, delay_s);
        const double rad_s = swing(kInertia, kp, kd, late);
        ASSERT_TRUE(margin < 0.2 || rad_s < 0.5) << late << " " << kp << " " << kd;
        ASSERT_TRUE(margin > -0.2 || rad_s > 0.5) << late << " " << kp << " " << kd;
      }
    }
  }
}

}  // namespace
}  // namespace lithe::robot
