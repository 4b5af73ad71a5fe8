// SPDX-License-Identifier: Apache-2.0
// The IMU of a simulated robot: that of its model, or of a base that is fixed.
#include <gtest/gtest.h>
#include <unistd.h>

#include <array>
#include <cmath>
#include <fstream>
#include <numbers>
#include <string>

#include "spine/hal/test/mechanism_rig.hpp"
#include "spine/robot/robot.hpp"

namespace lithe::hal {
namespace {

constexpr double kGravity = 9.81;
constexpr double kTrunkKgM2 = 0.01, kWheelKgM2 = 0.005;
const std::string kSensors =
    "<sensor><framequat objtype='site' objname='imu'/><gyro site='imu'/><accelerometer site='imu'/></sensor>";

// A free trunk, turned by 90 degrees about z, with a wheel on top that a drive turns.
std::string trunk(double height_m, const std::string& sensors = kSensors) {
  return "<mujoco><option gravity='0 0 -9.81'/><worldbody><geom type='plane' size='5 5 .1'/><body pos='0 0 " +
         std::to_string(height_m) +
         "' euler='0 0 90'><freejoint/><site name='imu'/><inertial pos='0 0 0' mass='1' diaginertia='.01 .01 .01'/>"
         "<geom type='box' size='.1 .1 .05' mass='0'/><body><joint name='j1' type='hinge' axis='0 0 1'/>"
         "<inertial pos='0 0 0' mass='.2' diaginertia='.005 .005 .005'/></body></body></worldbody>" +
         sensors + "</mujoco>";
}

robot::RobotConfig imu_robot(const std::string& plant) {
  std::string text = "name = \"r\"\n" + plant +
                     "[guard]\nsoft_start_s = 0\n[[bus]]\nname = \"b\"\nkind = \"loop\"\n"
                     "[[device]]\nname = \"d\"\nkind = \"moteus\"\nbus = \"b\"\nid = 1\nwatchdog_s = 0.2\n"
                     "[[device]]\nname = \"body_imu\"\nkind = \"imu\"\nbus = \"b\"\nwatchdog_s = 0.2\n"
                     "[[joint]]\nname = \"j1\"\ndevice = \"d\"\nposition_min_rad = -3\nposition_max_rad = 3\n"
                     "velocity_max_rad_s = 99\ntorque_max_nm = 9\ntorque_slew_nm_s = 1e5\nsafe_kd_nm_s_rad = 0.1\n";
  for (int i = 0; i < 10; ++i)
    text += "[[sensor]]\nname = \"s" + std::to_string(i) +
            "\"\ndevice = \"body_imu\"\nkind = \"imu\"\nchannel = " + std::to_string(i) + "\n";
  Result<robot::RobotConfig> config = robot::parse_robot(text, "/r.toml");
  EXPECT_TRUE(config) << config.message();
  return *config;
}

double s(const Robot& robot, std::size_t channel) { return robot.state.sensor[channel]; }

Robot with_model(const std::string& xml) {
  const std::string path = testing::TempDir() + "lithe_imu_" + std::to_string(::getpid()) + ".xml";
  std::ofstream(path) << xml;
  return Robot(imu_robot("[plant]\nkind = \"mujoco\"\nmodel = \"" + path + "\"\n"));
}

TEST(SimulatedImu, InFreeFallThereIsNoAccelerationAndItTurnsWithTheTrunk) {
  Robot robot = with_model(trunk(500));
  NEED_MUJOCO(robot);
  ASSERT_EQ(robot.why, "");
  robot.arm();
  robot.command.torque_nm[0] = 0.02;
  double turned_rad = 0;  // the integral of the angular rate
  for (int i = 0; i < 400; ++i) {
    robot.cycle();
    turned_rad += 1e-3 * s(robot, 6);
    for (std::size_t axis = 7; axis < 10; ++axis) ASSERT_NEAR(s(robot, axis), 0, 1e-6) << "tick " << i;
  }
  EXPECT_LT(turned_rad, -0.1) << "against the wheel";
  const double angle_rad = 2 * std::atan2(s(robot, 3), s(robot, 0)) - std::numbers::pi / 2;
  EXPECT_NEAR(angle_rad, turned_rad, 2e-3);
  // Nothing from outside turns them: the trunk has the angular momentum of the wheel, which turns beside it.
  const double wheel_rad_s = s(robot, 6) + robot.state.velocity_rad_s[0];
  EXPECT_NEAR(kTrunkKgM2 * s(robot, 6), -kWheelKgM2 * wheel_rad_s, 0.02 * kTrunkKgM2 * std::abs(s(robot, 6)));

  robot.command.reset_simulation = true;
  robot.cycle();
  EXPECT_NEAR(s(robot, 0), std::sqrt(0.5), 1e-3);
  EXPECT_NEAR(s(robot, 3), std::sqrt(0.5), 1e-3);
}

TEST(SimulatedImu, OnTheFloorItFeelsItsWeight) {
  Robot robot = with_model(trunk(0.06));
  NEED_MUJOCO(robot);
  ASSERT_EQ(robot.why, "");
  robot.cycle(2000);
  EXPECT_NEAR(s(robot, 9), kGravity, 0.05);
  EXPECT_NEAR(s(robot, 7), 0, 0.05);
  EXPECT_NEAR(s(robot, 8), 0, 0.05);
  EXPECT_NEAR(s(robot, 6), 0, 0.01);
  EXPECT_NEAR(s(robot, 0), std::sqrt(0.5), 1e-3);
}

TEST(SimulatedImu, AModelWithoutItsSensorsIsRefusedWithWhatToWrite) {
  const Robot robot = with_model(trunk(1, "<sensor><gyro site='imu'/></sensor>"));
  NEED_MUJOCO(robot);
  EXPECT_NE(robot.why.find("kind \"imu\""), std::string::npos) << robot.why;
  const std::size_t from = robot.why.find("<sensor>"), to = robot.why.find("</sensor>");
  ASSERT_NE(to, std::string::npos) << robot.why;
  EXPECT_EQ(with_model(trunk(1, robot.why.substr(from, to + 9 - from))).why, "") << "what was advised will do";
}

TEST(SimulatedImu, WithoutAModelTheBaseIsFixedAndLevel) {
  Robot robot(imu_robot("[plant]\nideal = true\n"));
  ASSERT_EQ(robot.why, "");
  robot.arm();
  robot.command.torque_nm[0] = 0.02;
  robot.cycle(200);
  constexpr std::array kLevel{1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 9.80665};
  for (std::size_t i = 0; i < kLevel.size(); ++i) EXPECT_EQ(s(robot, i), kLevel[i]) << i;
}

}  // namespace
}  // namespace lithe::hal
