// SPDX-License-Identifier: Apache-2.0
// What the model's observer predicts of a chain that another simulation moves.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <numbers>
#include <string>

#include "spine/guard/together/observer.hpp"
#include "spine/hal/physics/chain.hpp"
#include "spine/robot/robot.hpp"

namespace lithe::limits {
namespace {

constexpr double kPlantStepS = 5e-5, kPeriodS = 1e-3;
constexpr int kSteps = 20;

hal::sim::ChainParams plant_of(const robot::RobotConfig& robot) {
  hal::sim::ChainParams chain;
  chain.gravity_m_s2 = robot.plant.gravity_m_s2;
  for (const robot::JointConfig& joint : robot.joints) {
    const robot::PlantConfig& sim = joint.sim;
    chain.links.push_back({sim.length_m, sim.mass_kg, sim.center_m, sim.link_inertia_kg_m2, sim.rotor_inertia_kg_m2,
                           hal::sim::PlantParams{.viscous_nm_s_rad = sim.viscous_nm_s_rad,
                                                 .coulomb_nm = sim.coulomb_nm,
                                                 .torque_lag_s = sim.torque_lag_s}});
  }
  return chain;
}

// The root mean square over all joints of the error of the predicted speed, one tick ahead, in a motion by torques that
// swing about gravity. The drives' filter is far above the motion and left out.
double error_rad_s(robot::RobotConfig robot, double coulomb_nm) {
  for (robot::JointConfig& joint : robot.joints) {
    joint.model.coulomb_nm = coulomb_nm;
    joint.model.velocity_filter_rad_s = 1e5;
    joint.safe_kd_nm_s_rad = 0;
  }
  hal::sim::Chain plant(plant_of(robot));
  guard::Observer observer;
  observer.configure(robot);
  double squares = 0;
  int count = 0;
  std::array<bool, kMaxJoints> fresh{};
  for (int tick = 0; tick < 3000; ++tick) {
    JointArray position_rad{}, velocity_rad_s{}, torque_nm{};
    for (std::size_t j = 0; j < robot.joints.size(); ++j) {
      fresh[j] = true;
      position_rad[j] = plant.position_rad(j);
      velocity_rad_s[j] = plant.velocity_rad_s(j);
      if (tick > 100) {
        const double off = velocity_rad_s[j] - observer.next().velocity_rad_s[j];
        squares += off * off;
        ++count;
      }
    }
    observer.observe({position_rad, velocity_rad_s, fresh, 0});
    for (std::size_t j = 0; j < robot.joints.size(); ++j) {
      const double swing = std::sin(2 * std::numbers::pi * kPeriodS * tick + static_cast<double>(j));
      torque_nm[j] = std::array{0.5, 0.2, 0.08}[j] * swing - 0.05 * velocity_rad_s[j];
      observer.command(j, Pd{.torque_nm = torque_nm[j]}, robot.joints[j].torque_max_nm);
    }
    observer.dispatched();
    for (int i = 0; i < kSteps; ++i) plant.step(torque_nm);
  }
  return std::sqrt(squares / count);
}

TEST(Observer, ThatKnowsTheDryFrictionPredictsTheSpeed) {
  const Result<robot::RobotConfig> robot = robot::load_robot(std::string(LITHE_ROBOTS) + "/chain.toml");
  ASSERT_TRUE(robot) << robot.message();
  const double knows = error_rad_s(*robot, robot->joints[0].sim.coulomb_nm), ignores = error_rad_s(*robot, 0);
  std::printf("error of the speed one tick ahead: %.2g rad/s, without the friction %.2g\n", knows, ignores);
  EXPECT_LT(knows, 0.3 * ignores);
}

}  // namespace
}  // namespace lithe::limits
