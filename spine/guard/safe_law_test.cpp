// SPDX-License-Identifier: Apache-2.0
#include "spine/guard/safe_law.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

namespace lithe::guard {
namespace {

constexpr double kDt = 0.001;

// One joint of inertia 0.01 with gravity, driven by the safe law at 1 kHz.
struct Arm {
  explicit Arm(robot::SafeEnd end, double gravity) : gravity_nm(gravity) {
    robot::RobotConfig robot;
    robot.guard.safe_end = end;
    robot.joints.resize(1);
    robot::JointConfig& joint = robot.joints[0];
    joint.position_min_rad = -3;
    joint.position_max_rad = 3;
    joint.velocity_max_rad_s = 20;
    joint.deceleration_rad_s2 = 20;
    joint.safe_kp_nm_rad = 20;
    joint.safe_kd_nm_s_rad = 0.8;
    law.configure(robot);
  }
  void run(double seconds) {
    for (double t = 0; t < seconds; t += kDt) {
      const double torque_nm = law.torque_nm(0, position[0], velocity[0]);
      velocity[0] += (torque_nm - gravity_nm) / 0.01 * kDt;
      position[0] += velocity[0] * kDt;
      largest_nm = std::max(largest_nm, std::abs(torque_nm));
    }
  }
  SafeLaw law;
  double gravity_nm;
  double largest_nm = 0;
  JointArray position{}, velocity{};
};

TEST(SafeLaw, HoldSlowsDownAtTheConfiguredRateAndStaysThere) {
  Arm arm(robot::SafeEnd::hold, 0.0);
  arm.velocity[0] = 4;
  arm.run(0.1);
  EXPECT_NEAR(arm.velocity[0], 2.0, 0.3);  // half way: 20 rad/s2 for 0.1 s
  arm.run(2.0);
  EXPECT_NEAR(arm.velocity[0], 0.0, 0.01);
  EXPECT_NEAR(arm.position[0], 4.0 * 4.0 / (2 * 20), 0.05);  // v^2 / 2a
}

TEST(SafeLaw, HoldCarriesALoad) {
  Arm arm(robot::SafeEnd::hold, 0.5);
  arm.position[0] = 1;
  arm.run(2.0);
  EXPECT_NEAR(arm.position[0], 1.0 - 0.5 / 20, 0.01);
}

TEST(SafeLaw, DampEndsWithDampingAlone) {
  Arm arm(robot::SafeEnd::damp, 0.4);
  arm.position[0] = 1;
  arm.velocity[0] = 2;
  arm.run(1.0);
  EXPECT_NEAR(arm.velocity[0], -0.4 / 0.8, 0.01);  // sinks at gravity / damping
}

TEST(SafeLaw, StandingStillItAsksForNothing) {
  Arm arm(robot::SafeEnd::damp, 0.0);
  arm.run(0.1);
  EXPECT_EQ(arm.largest_nm, 0.0);
}

TEST(SafeLaw, ItNeverSteersBeyondAPositionLimit) {
  Arm arm(robot::SafeEnd::hold, 0.0);
  arm.position[0] = 2.9;
  arm.velocity[0] = 10;  // needs 2.5 rad to stop
  arm.run(3.0);
  EXPECT_NEAR(arm.position[0], 3.0, 0.01);
}

TEST(SafeLaw, RearmingTakesTheNewState) {
  Arm arm(robot::SafeEnd::hold, 0.0);
  arm.run(0.01);
  arm.position[0] = 1;
  arm.law.rearm(0);
  arm.run(0.01);
  EXPECT_EQ(arm.largest_nm, 0.0);
}

}  // namespace
}  // namespace lithe::guard
