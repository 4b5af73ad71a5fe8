// SPDX-License-Identifier: Apache-2.0
// Joints that hang on each other, as the loop sees them: through drives of both kinds, over buses.
#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <string>
#include <vector>

#include "spine/core/test/no_alloc_rig.hpp"
#include "spine/core/test/units_rig.hpp"
#include "spine/core/time.hpp"
#include "spine/hal/sim/simulate.hpp"
#include "spine/hal/test/mechanism_rig.hpp"
#include "spine/robot/robot.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::hal {
namespace {

// What each joint moves: the same numbers for a chain and for a model.
struct ChainLink {
  const char* kind;  // of its drive
  double length_m, mass_kg, center_m, inertia_kg_m2, rotor_kg_m2, viscous_nm_s_rad, start_rad;
};
const std::vector<ChainLink> kArm = {
    {"cia402", 0.30, 0.8, 0.14, 6e-3, 4e-2, 8e-2, 0.3},
    {"moteus", 0.25, 0.4, 0.12, 2e-3, 4e-3, 3e-2, -0.4},
    {"moteus", 0.20, 0.2, 0.09, 8e-4, 4e-3, 3e-2, 0.2},
};

// The name counts the process in: tests run side by side.
std::string scratch(const std::string& name) {
  return testing::TempDir() + "lithe_" + std::to_string(::getpid()) + "_" + name;
}

std::string number(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%.17g", value);
  return text;
}

std::string robot_text(const std::vector<ChainLink>& links, const std::string& plant, bool with_links) {
  std::string text =
      "name = \"r\"\n" + plant +
      "[guard]\nsoft_start_s = 0\n[[bus]]\nname = \"moteus\"\nkind = \"loop\"\n[[bus]]\nname = \"cia402\"\nkind = "
      "\"loop\"\n"
      "data_bitrate = 0\n[defaults.joint]\nposition_min_rad = -3\nposition_max_rad = 3\n"
      "velocity_max_rad_s = 99\ntorque_max_nm = 9\ntorque_slew_nm_s = 1e5\nsafe_kd_nm_s_rad = 0.1\nratio = 6\n";
  for (std::size_t i = 0; i < links.size(); ++i) {
    const ChainLink& link = links[i];
    const std::string n = std::to_string(i + 1);
    text += "[[device]]\nname = \"d" + n + "\"\nkind = \"" + link.kind + "\"\nbus = \"" + link.kind + "\"\nid = " + n +
            "\nwatchdog_s = 0.2\n" + (link.kind == std::string("cia402") ? "rated_torque_nm = 0.6\n" : "") +
            "[[joint]]\nname = \"j" + n + "\"\ndevice = \"d" + n + "\"\n" + (i == 1 ? "sign = -1\n" : "") +
            "[joint.sim]\ninitial_position_rad = " + number(link.start_rad) + "\n";
    if (!with_links) continue;
    text += "length_m = " + number(link.length_m) + "\nmass_kg = " + number(link.mass_kg) +
            "\ncenter_m = " + number(link.center_m) + "\nlink_inertia_kg_m2 = " + number(link.inertia_kg_m2) +
            "\nrotor_inertia_kg_m2 = " + number(link.rotor_kg_m2) +
            "\nviscous_nm_s_rad = " + number(link.viscous_nm_s_rad) + "\n";
  }
  return text;
}

robot::RobotConfig parsed(const std::string& text) {
  Result<robot::RobotConfig> config = robot::parse_robot(text, "/r.toml");
  EXPECT_TRUE(config) << config.message();
  return *config;
}

robot::RobotConfig chain_of(const std::vector<ChainLink>& links) {
  return parsed(robot_text(links, "[plant]\nkind = \"chain\"\n", true));
}

// Hinges about z in the plane of x and y, gravity along -y; nothing touches anything. One position actuator, which
// would hold the first joint if it were not off.
std::string model_of(const std::vector<ChainLink>& links) {
  std::string open, close;
  double above = 0;
  for (std::size_t i = 0; i < links.size(); ++i) {
    const std::string inertia = number(links[i].inertia_kg_m2);
    open += "<body pos='0 " + number(-above) + " 0'><joint name='j" + std::to_string(i + 1) +
            "' type='hinge' axis='0 0 1' armature='" + number(links[i].rotor_kg_m2) + "' damping='" +
            number(links[i].viscous_nm_s_rad) + "'/><inertial pos='0 " + number(-links[i].center_m) + " 0' mass='" +
            number(links[i].mass_kg) + "' diaginertia='" + inertia + " " + inertia + " " + inertia + "'/>";
    close += "</body>";
    above = links[i].length_m;
  }
  return "<mujoco><option timestep='0.002' gravity='0 -9.81 0'/><worldbody>" + open + close +
         "</worldbody><actuator><position joint='j1' kp='100'/></actuator></mujoco>";
}

robot::RobotConfig model_robot(const std::vector<ChainLink>& links, const std::string& xml,
                               const std::string& more = "") {
  const std::string path = scratch("model.xml");
  std::ofstream(path) << xml;
  return parsed(robot_text(links, "[plant]\nkind = \"mujoco\"\nmodel = \"" + path + "\"\n" + more, false));
}

TEST(Mechanism, ATorqueAtTheBaseMovesWhatHangsOnIt) {
  std::vector<ChainLink> hanging = kArm;
  for (ChainLink& link : hanging) link.start_rad = 0;
  Robot robot(chain_of(hanging));
  ASSERT_EQ(robot.why, "");
  robot.arm();
  EXPECT_NEAR(robot.state.position_rad[2], 0, 1e-3);
  robot.command.torque_nm[0] = 4;
  double farthest_rad = 0;
  for (int i = 0; i < 500; ++i) {
    robot.cycle();
    farthest_rad = std::max(farthest_rad, std::abs(robot.state.position_rad[2]));
  }
  EXPECT_GT(farthest_rad, 0.05);
}

TEST(Mechanism, EachJointIsItsOwnLinkWhateverTheOrderOfDevices) {
  Robot robot(chain_of(kArm));
  ASSERT_EQ(robot.why, "");
  robot.cycle();
  EXPECT_LT(robot.state.position_rad[1], 0);
  EXPECT_GT(robot.state.position_rad[2], 0);
}

// What a drive must give to hold still is what hangs on its joint, all links counted. On average: a joint that is held
// without friction hunts between two counts of its encoder.
TEST(Mechanism, HoldingTorquesAreThoseOfAllThatHangs) {
  Robot robot(chain_of(kArm));
  ASSERT_EQ(robot.why, "");
  robot.arm();
  const double kp[] = {40, 10, 6}, kd[] = {2, 0.3, 0.15};
  constexpr int kTicks = 12'000, kStillTicks = 4'000;
  std::vector<double> held_nm(3);
  for (int i = 0; i < kTicks; ++i) {
    for (std::size_t j = 0; j < 3; ++j) {
      const double wanted = i < 3000 ? 0.4 * i / 3000 : 0.4;
      robot.command.torque_nm[j] =
          kp[j] * (wanted - robot.state.position_rad[j]) - kd[j] * robot.state.velocity_rad_s[j];
    }
    robot.cycle();
    if (i < kTicks - kStillTicks) continue;
    for (std::size_t j = 0; j < 3; ++j) held_nm[j] += robot.state.torque_nm[j] / kStillTicks;
  }
  double angle = 0;
  std::vector<double> weight(3), angles(3);
  for (std::size_t i = 0; i < 3; ++i) angles[i] = angle += robot.state.position_rad[i];
  for (std::size_t j = 0; j < 3; ++j) {
    for (std::size_t i = j; i < 3; ++i) {
      double way = kArm[i].center_m * std::sin(angles[i]);
      for (std::size_t k = j; k < i; ++k) way += kArm[k].length_m * std::sin(angles[k]);
      weight[j] += 9.81 * kArm[i].mass_kg * way;
    }
    EXPECT_NEAR(held_nm[j], weight[j], 0.005) << j;
  }
}

TEST(Mechanism, AChainIsSimulatedAltogetherOrNotAtAll) {
  robot::RobotConfig config = chain_of(kArm);
  config.buses[0].kind = robot::BusKind::fdcanusb;
  config.buses[0].path = "/dev/nowhere";
  const Robot robot(config);
  EXPECT_NE(robot.why.find("[plant] joins all joints, but bus 'moteus' is real"), std::string::npos) << robot.why;
}

// As an arm that is pushed about: torques of several frequencies, with damping by the drives' own measurements.
double swing_apart(Robot& ours, Robot& theirs, int ticks, double& farthest_rad) {
  double worst = 0;
  for (int i = 0; i < ticks; ++i) {
    const double t = 1e-3 * i;
    for (std::size_t j = 0; j < ours.command.joints; ++j) {
      const double n = static_cast<double>(j);
      const double torque = (1.0 - 0.35 * n) * std::sin((3 + n) * t + n);
      ours.command.torque_nm[j] = theirs.command.torque_nm[j] = torque;
    }
    ours.cycle();
    theirs.cycle();
    for (std::size_t j = 0; j < ours.command.joints; ++j) {
      worst = std::max(worst, std::abs(ours.state.position_rad[j] - theirs.state.position_rad[j]));
      farthest_rad = std::max(farthest_rad, std::abs(ours.state.position_rad[j]));
    }
  }
  return worst;
}

TEST(Mechanism, AModelInMujocoAndTheBuiltInChainMoveAlikeUnderTheSameDrives) {
  struct Case {
    const char* more;
    double apart_rad;
  };
  for (const Case& each : {Case{"", 5e-3}, Case{"step_s = 2.5e-4\n", 1.5e-2}}) {
    Robot theirs(model_robot(kArm, model_of(kArm), each.more));
    NEED_MUJOCO(theirs);
    ASSERT_EQ(theirs.why, "");
    Robot ours(chain_of(kArm));
    ours.arm();
    theirs.arm();
    double farthest_rad = 0;
    const double worst = swing_apart(ours, theirs, 3000, farthest_rad);
    std::printf("3 s under torque, up to %.2f rad: at most %.2g rad apart\n", farthest_rad, worst);
    EXPECT_GT(farthest_rad, 0.5);
    EXPECT_LT(worst, each.apart_rad) << each.more;
  }
}

TEST(Mechanism, AResetPutsTheJointsOfAModelBackWhereTheyBegan) {
  std::vector<ChainLink> links = kArm;
  links[0].start_rad = 0.4;
  Robot robot(model_robot(links, model_of(links)));
  NEED_MUJOCO(robot);
  ASSERT_EQ(robot.why, "");
  robot.cycle(300);
  ASSERT_GT(std::abs(robot.state.position_rad[0] - 0.4), 0.05) << "it swings";
  robot.command.reset_simulation = true;
  robot.cycle();
  robot.command.reset_simulation = false;
  EXPECT_NEAR(robot.state.position_rad[0], 0.4, 5e-3);
  EXPECT_LT(std::abs(robot.state.velocity_rad_s[0]), 0.2);
}

TEST(Mechanism, ATwinWithAnotherMassIsToldApart) {
  std::vector<ChainLink> heavier = kArm;
  heavier[2].mass_kg *= 1.05;
  Robot theirs(model_robot(kArm, model_of(heavier)));
  NEED_MUJOCO(theirs);
  ASSERT_EQ(theirs.why, "");
  Robot ours(chain_of(kArm));
  ours.arm();
  theirs.arm();
  double farthest_rad = 0;
  EXPECT_GT(swing_apart(ours, theirs, 3000, farthest_rad), 3e-2);
}

// A floor below the tip: links rest on it, and nothing is allocated for that.
TEST(Mechanism, AModelWithContactsStepsWithoutAllocating) {
  std::string xml = model_of(kArm);
  xml.insert(xml.find("<worldbody>") + 11, "<geom type='plane' size='5 5 .1' pos='0 -0.6 0' zaxis='0 1 0'/>");
  const std::string tip = "<geom type='sphere' size='0.03' pos='0 -0.2 0' mass='0'/>";
  xml.insert(xml.find("</body>"), tip);
  Robot robot(model_robot(kArm, xml));
  NEED_MUJOCO(robot);
  ASSERT_EQ(robot.why, "");
  robot.arm();
  robot.command.torque_nm[0] = 0.5;
  {
    const NoAllocScope scope;
    robot.cycle(2000);
  }
  EXPECT_GT(std::abs(robot.state.position_rad[0]) + std::abs(robot.state.position_rad[1]), 0.02)
      << "the floor is there";
}

TEST(Mechanism, WhatAModelLacksIsNamed) {
  const Robot none(model_robot(kArm, model_of({kArm[0], kArm[1]})));
  NEED_MUJOCO(none);
  EXPECT_NE(none.why.find("[plant] model: "), std::string::npos) << none.why;
  EXPECT_NE(none.why.find("there is no joint 'j3'; its hinges: j1, j2"), std::string::npos) << none.why;
  std::string sliding = model_of(kArm);
  sliding.replace(sliding.find("type='hinge'"), 12, "type='slide'");
  EXPECT_NE(Robot(model_robot(kArm, sliding)).why.find("joint 'j1' is no hinge"), std::string::npos);
  EXPECT_NE(Robot(model_robot(kArm, "<mujoco><wrold/></mujoco>")).why.find("wrold"), std::string::npos);
  const std::string newer =
      Robot(model_robot(kArm, "<mujoco><worldbody><body sleep='auto'/></worldbody></mujoco>")).why;
  EXPECT_NE(newer.find("a model for a newer one"), std::string::npos) << newer;
  EXPECT_NE(Robot(model_robot(kArm, sliding)).why.find("make it one"), std::string::npos);
  robot::RobotConfig lost = model_robot(kArm, "");
  lost.plant.model = "/nowhere/leg.xml";
  EXPECT_NE(Robot(lost).why.find("/nowhere/leg.xml"), std::string::npos);
}

// The file's limits and the start: a joint at its stop in the model never arrives, and one beyond it leaps.
TEST(Mechanism, AModelThatTurnsLessThanTheRobotFileSaysIsRefusedWithWhatToWrite) {
  std::string narrow = model_of(kArm);
  narrow.insert(narrow.find("type='hinge'"), "limited='true' range='-30 30' ");
  const auto why = [&](double least_rad, double most_rad, double start_rad) {
    robot::RobotConfig robot = model_robot(kArm, narrow);
    robot.joints[0].position_min_rad = least_rad;
    robot.joints[0].position_max_rad = most_rad;
    robot.joints[0].sim.initial_position_rad = start_rad;
    return Robot(robot).why;
  };
  if (why(0, 0, 0).find("libmujoco-dev") != std::string::npos) GTEST_SKIP() << why(0, 0, 0);
  EXPECT_NE(why(-2.5, 0.5, 0).find("write position_min_rad = -0.5236 and position_max_rad = 0.5000"), std::string::npos)
      << why(-2.5, 0.5, 0);
  EXPECT_EQ(why(-0.5236, 0.5, 0).find("turns from"), std::string::npos) << "what was advised will do";
  EXPECT_NE(why(-0.5236, 0.5, 1.5).find("and starts at 1.5"), std::string::npos) << why(-0.5236, 0.5, 1.5);
}

}  // namespace
}  // namespace lithe::hal
