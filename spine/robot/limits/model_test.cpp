// SPDX-License-Identifier: Apache-2.0
// [model] and [joint.model] of a robot file.
#include "spine/robot/limits/model.hpp"

#include <gtest/gtest.h>

#include <string>

#include "spine/robot/robot.hpp"
#include "spine/robot/values.hpp"

namespace lithe::robot {
namespace {

std::string with_joint(const std::string& name, int id, const std::string& model) {
  return "[[device]]\nname = \"" + name + "_drive\"\nkind = \"moteus\"\nbus = \"b\"\nid = " + std::to_string(id) +
         "\n[[joint]]\nname = \"" + name + "\"\ndevice = \"" + name +
         "_drive\"\nposition_min_rad = -3\nposition_max_rad = 3\nvelocity_max_rad_s = 10\ntorque_max_nm = 6\n"
         "torque_slew_nm_s = 1200\nload_max_nm = 1\ninertia_max_kg_m2 = 0.05\nsafe_kd_nm_s_rad = 0.1\n" +
         (model.empty() ? "" : "[joint.model]\n" + model);
}
const std::string kModelHead = "name = \"r\"\n[[bus]]\nname = \"b\"\nkind = \"loop\"\n";
const std::string kModelTable = "[model]\n";
const std::string kModelLink = "mass_kg = 0.3\ncenter_m = [0, 0, -0.2]\naxis = [0, 2, 0]\n";

std::string mistake_of(const std::string& text) {
  const Result<RobotConfig> robot = parse_robot(text, "r.toml");
  return robot ? "none" : robot.message();
}
void expect_says(const std::string& text, const std::string& phrase) {
  EXPECT_NE(text.find(phrase), std::string::npos) << text;
}

TEST(Model, LinksFollowEachOtherUnlessAParentIsNamed) {
  const Result<RobotConfig> robot = parse_robot(
      kModelHead + kModelTable + with_joint("a", 1, kModelLink) + with_joint("b", 2, kModelLink) +
          with_joint("c", 3, kModelLink + "parent = \"a\"\n") + with_joint("d", 4, kModelLink + "parent = \"base\"\n"),
      "r.toml");
  ASSERT_TRUE(robot) << robot.message();
  const auto parent = [&](std::size_t j) { return robot->joints[j].model.link.parent; };
  EXPECT_EQ(parent(0), mechanics::Link::kBase);
  EXPECT_EQ(parent(1), 0U);
  EXPECT_EQ(parent(2), 0U);
  EXPECT_EQ(parent(3), mechanics::Link::kBase);
  EXPECT_EQ(robot->joints[0].model.link.axis.y, 1) << "made a unit vector";
}

// One link: what is left of its torque beside gravity, by its inertia.
TEST(Model, AllotsWhatGravityAndTheErrorLeave) {
  const Result<RobotConfig> robot = parse_robot(kModelHead + kModelTable + with_joint("a", 1, kModelLink), "r.toml");
  ASSERT_TRUE(robot) << robot.message();
  const double usable = kUsableTorque * 6 / 1.4, heaviest = 0.3 * 9.81 * 0.2, inertia = 0.3 * 0.2 * 0.2;
  EXPECT_NEAR(robot->joints[0].model.allotted_rad_s2, (usable - heaviest) / inertia, 1);
}

TEST(Model, APoseInWhichGravityLeavesNothingIsRefusedWithItsJoint) {
  const std::string text = mistake_of(kModelHead + kModelTable +
                                      with_joint("a", 1, "mass_kg = 3\ncenter_m = [0, 0, -0.4]\naxis = [0, 1, 0]\n"));
  expect_says(text, "rad gravity pulls at joint \"a\" with");
  expect_says(text, "more torque_max_nm");
}

TEST(Model, IsOfAllJointsOrOfNone) {
  expect_says(mistake_of(kModelHead + kModelTable + with_joint("a", 1, kModelLink) + with_joint("b", 2, "")),
              "joint \"b\" has no [joint.model]");
  expect_says(mistake_of(kModelHead + with_joint("a", 1, kModelLink)), "there is no [model]");
}

TEST(Model, ADriveThatIsNotAskedInEveryTickIsRefusedByName) {
  const std::string text = "[defaults.device]\nrate_divider = 2\n";
  expect_says(mistake_of(kModelHead + kModelTable + text + with_joint("a", 1, kModelLink)),
              "\"a_drive\" has rate_divider = 2");
}

// A velocity or position loop in the drive does not take the torque that the guard decides.
TEST(Model, ADriveWithALoopOfItsOwnIsRefusedByName) {
  const auto with_mode = [](const std::string& mode) {
    return mistake_of(
        "name = \"r\"\n[model]\n[[bus]]\nname = \"c\"\nkind = \"slcan\"\npath = \"/dev/x\"\n[[device]]\nname = "
        "\"d\"\nkind = "
        "\"cia402\"\nbus = \"c\"\nid = 1\nrated_torque_nm = 3\nmode = \"" +
        mode +
        "\"\n[[joint]]\nname = \"a\"\ndevice = \"d\"\nposition_min_rad = -1\nposition_max_rad = 1\nvelocity_max_rad_s "
        "= 9\n"
        "torque_max_nm = 6\ntorque_slew_nm_s = 600\nload_max_nm = 1\ninertia_max_kg_m2 = 0.02\nsafe_kd_nm_s_rad = "
        "0.1\n[joint.model]\n" +
        kModelLink);
  };
  expect_says(with_mode("velocity"), "\"d\" closes a velocity or position loop of its own");
  expect_says(with_mode("position"), "\"d\" closes a velocity or position loop of its own");
  EXPECT_EQ(with_mode("torque"), "none");
}

// A Spine that runs is taken over only by a file with the same values: a list counts, too.
TEST(Model, EveryNumberOfAListIsOneOfTheFilesValues) {
  const auto values = [](const std::string& link) {
    return parse_robot(kModelHead + kModelTable + with_joint("a", 1, link), "r.toml")->values;
  };
  EXPECT_EQ(values_hash(values(kModelLink)), values_hash(values(kModelLink + "offset_m = [0, 0, 0]\n")));
  EXPECT_NE(values_hash(values(kModelLink)), values_hash(values(kModelLink + "offset_m = [0, 0, 0.1]\n")));
}

TEST(Model, MistakesAreNamed) {
  const auto with = [](const std::string& keys) {
    return mistake_of(kModelHead + kModelTable + with_joint("a", 1, keys));
  };
  expect_says(with("center_m = [0, 0, 1]\n"), "mass_kg");
  expect_says(with(kModelLink + "parent = \"z\"\n"), "\"z\" is no [[joint]] above this one");
  expect_says(with(kModelLink + "offset_m = [0, 1]\n"), "a list of 3 numbers");
  expect_says(with("mass_kg = 1\naxis = [0, 0, 0]\n"), "has no direction");
  expect_says(with(kModelLink + "inertia_kg_m2 = [1, 1, 3, 0, 0, 0]\n"), "is of no body");
  expect_says(with("mass_kg = 0\n"), "no inertia about some joint");
}

}  // namespace
}  // namespace lithe::robot
