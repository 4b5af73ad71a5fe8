// SPDX-License-Identifier: Apache-2.0
// [plant]: keys of one kind of plant are refused in another, with the reason.
#include "spine/robot/keys/sections.hpp"

#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "spine/robot/robot.hpp"

namespace lithe::robot {
namespace {

const std::string kTop = "name = \"r\"\n[[bus]]\nname = \"b\"\nkind = \"loop\"\n";
const std::string kChain = "[plant]\nkind = \"chain\"\n";
const std::string kModel = "[plant]\nkind = \"mujoco\"\nmodel = \"leg.xml\"\n";

// A joint and its drive; `sim` is the text of [joint.sim]; without it there is none.
std::string joint(int number, const std::string& sim = "") {
  const std::string n = std::to_string(number);
  return "[[device]]\nname = \"d" + n + "\"\nkind = \"moteus\"\nbus = \"b\"\nid = " + n + "\n[[joint]]\nname = \"j" +
         n + "\"\ndevice = \"d" + n +
         "\"\nposition_min_rad = -1\nposition_max_rad = 1\nvelocity_max_rad_s = 9\ntorque_max_nm = 1\n"
         "torque_slew_nm_s = 100\nsafe_kd_nm_s_rad = 0.1\n" +
         (sim.empty() ? "" : "[joint.sim]\n" + sim);
}

void expect_refused(const std::string& text, const std::vector<std::string>& phrases) {
  const Result<RobotConfig> robot = parse_robot(kTop + text, "/robots/r.toml");
  ASSERT_FALSE(robot) << "accepted, but should say: " << phrases.front();
  for (const std::string& phrase : phrases)
    EXPECT_NE(robot.message().find(phrase), std::string::npos) << robot.message() << "\nlacks: " << phrase;
}

RobotConfig accepted(const std::string& text) {
  Result<RobotConfig> robot = parse_robot(kTop + text, "/robots/r.toml");
  EXPECT_TRUE(robot) << robot.message();
  return robot ? *robot : RobotConfig{};
}

TEST(Plants, EveryJointIsOnItsOwnUnlessTheFileSaysOtherwise) {
  const RobotConfig robot = accepted(joint(1, "mgl_nm = 0.5\n"));
  EXPECT_EQ(robot.plant.kind, PlantKind::independent);
  EXPECT_EQ(robot.joints[0].sim.mgl_nm, 0.5);
  EXPECT_EQ(accepted("[plant]\nkind = \"independent\"\n" + joint(1)).plant.kind, PlantKind::independent);
}

TEST(Plants, GravityPullsDownwards) {
  expect_refused(joint(1, "mgl_nm = -0.8\n"), {"j1.sim: mgl_nm: -0.8 will not do", "0"});
}

TEST(Plants, LinksOfAChainAreThinRodsUnlessTheySayMore) {
  const RobotConfig robot = accepted(kChain + "gravity_m_s2 = 1.62\n" + joint(1, "length_m = 0.3\nmass_kg = 0.4\n") +
                                     joint(2,
                                           "length_m = 0.2\nmass_kg = 0.1\ncenter_m = 0.15\nlink_inertia_kg_m2 = 1e-3\n"
                                           "rotor_inertia_kg_m2 = 2e-3\nviscous_nm_s_rad = 1e-3\n"));
  EXPECT_EQ(robot.plant.kind, PlantKind::chain);
  EXPECT_EQ(robot.plant.gravity_m_s2, 1.62);
  EXPECT_DOUBLE_EQ(robot.joints[0].sim.center_m, 0.15);
  EXPECT_DOUBLE_EQ(robot.joints[0].sim.link_inertia_kg_m2, 0.4 * 0.09 / 12);
  EXPECT_EQ(robot.joints[0].sim.rotor_inertia_kg_m2, 0.0);
  EXPECT_EQ(robot.joints[1].sim.center_m, 0.15);
  EXPECT_EQ(robot.joints[1].sim.link_inertia_kg_m2, 1e-3);
  EXPECT_EQ(robot.joints[1].sim.rotor_inertia_kg_m2, 2e-3);
}

TEST(Plants, DefaultsGiveLinksToJointsThatSayNothing) {
  const RobotConfig robot = accepted(kChain + "[defaults.joint.sim]\nlength_m = 0.3\nmass_kg = 0.4\n" + joint(1) +
                                     joint(2, "mass_kg = 0.8\n"));
  EXPECT_EQ(robot.joints[0].sim.mass_kg, 0.4);
  EXPECT_EQ(robot.joints[1].sim.mass_kg, 0.8);
  EXPECT_DOUBLE_EQ(robot.joints[1].sim.link_inertia_kg_m2, 0.8 * 0.09 / 12);
}

TEST(Plants, ALinkThatLacksSomethingIsNamed) {
  expect_refused(kChain + joint(1), {"[[joint]] j1: sim: ", "needs length_m"});
  expect_refused(kChain + joint(1, "length_m = 0.3\n"), {"[[joint]] j1: sim: ", "needs mass_kg"});
  expect_refused(kChain + joint(1, "length_m = 0.3\nmass_kg = 0.0\n"), {"no inertia", "rotor_inertia_kg_m2"});
  expect_refused(kChain + joint(1, "length_m = -0.3\nmass_kg = 1\n"), {"length_m: -0.3 will not do"});
  expect_refused(kChain + joint(1, "length_m = 0.3\nmass_kg = \"1\"\n"), {"mass_kg: this is a string"});
  expect_refused(kChain + joint(1, "lenght_m = 0.3\nmass_kg = 1\n"), {"'lenght_m' is no key", "'length_m'"});
}

TEST(Plants, KeysOfAnotherKindAreRefusedWithTheReason) {
  const std::string link = "length_m = 0.3\nmass_kg = 0.4\n";
  expect_refused(kChain + joint(1, link + "mgl_nm = 0.2\n"), {"j1.sim: mgl_nm", "the links make it"});
  expect_refused(kChain + joint(1, link + "inertia_kg_m2 = 0.2\n"), {"j1.sim: inertia_kg_m2", "the links make it"});
  expect_refused(joint(1, link), {"length_m: is for [plant] kind = \"chain\" only", "mass_kg: is for"});
  expect_refused(kModel + joint(1, "mass_kg = 1\n"), {"mass_kg: this is set in the model"});
  expect_refused(kModel + joint(1, "coulomb_nm = 1\n"), {"coulomb_nm: this is set in the model"});
  expect_refused(kModel + "gravity_m_s2 = 1\n" + joint(1), {"[plant]: gravity_m_s2: gravity is set in the model"});
  expect_refused("[plant]\ngravity_m_s2 = 1\n" + joint(1), {"gravity_m_s2", "mgl_nm"});
  expect_refused(kChain + "model = \"leg.xml\"\n" + joint(1, link), {"model: is for kind = \"mujoco\" only"});
}

TEST(Plants, AModelIsFoundBesideItsRobotFile) {
  const RobotConfig robot = accepted(kModel + "step_s = 2e-4\n" + joint(1, "torque_lag_s = 0\n"));
  EXPECT_EQ(robot.plant.model, "/robots/leg.xml");
  EXPECT_EQ(robot.plant.step_s, 2e-4);
  EXPECT_EQ(robot.joints[0].sim.torque_lag_s, 0.0);
}

TEST(Plants, WhatThePlantLacksOrMistypesIsNamed) {
  expect_refused("[plant]\nkind = \"mujoco\"\n" + joint(1), {"[plant]: model is missing"});
  expect_refused("[plant]\nkind = \"mujocco\"\n" + joint(1), {"did you mean \"mujoco\"?"});
  expect_refused(kModel + "step_s = 7e-5\n" + joint(1), {"step_s: 7e-05 is no multiple of 5e-05"});
  expect_refused(kModel + "step_s = 1\n" + joint(1), {"step_s: 1 will not do"});
  expect_refused(kModel + "modle = \"x\"\n" + joint(1), {"'modle' is no key in [plant]", "'model'"});
  expect_refused(kChain + "gravity_m_s2 = \"moon\"\n" + joint(1), {"gravity_m_s2: this is a string"});
}

}  // namespace
}  // namespace lithe::robot
