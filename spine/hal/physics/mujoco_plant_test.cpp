// SPDX-License-Identifier: Apache-2.0
// The chain against somebody else's physics, where it is at hand: MuJoCo of Debian 12, libmujoco-dev.
#include <gtest/gtest.h>

#include "spine/hal/physics/chain.hpp"
#include "spine/hal/physics/mujoco_plant.hpp"

#ifdef LITHE_MUJOCO
#include <mujoco/mujoco.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <memory>
#include <random>
#include <string>
#include <vector>
#endif

namespace lithe::hal::sim {
namespace {

#ifndef LITHE_MUJOCO

TEST(ChainMujoco, AgreesInAccelerationAndMotion) {
  GTEST_SKIP() << "MuJoCo is not installed; apt-get install libmujoco-dev, then configure again";
}

#else

constexpr double kStepS = 1e-9 * static_cast<double>(Plant::kStepNs);

std::string number(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%.17g", value);
  return text;
}

// Hinges about z in the plane of x and y, gravity along -y; nothing touches anything.
std::string model_of(const ChainParams& params) {
  std::string open, close;
  double above = 0;
  for (const ChainLink& link : params.links) {
    const std::string inertia = number(link.inertia_kg_m2);
    open += "<body pos='0 " + number(-above) + " 0'><joint type='hinge' axis='0 0 1' armature='" +
            number(link.rotor_inertia_kg_m2) + "' damping='" + number(link.joint.viscous_nm_s_rad) +
            "'/><inertial pos='0 " + number(-link.center_m) + " 0' mass='" + number(link.mass_kg) + "' diaginertia='" +
            inertia + " " + inertia + " " + inertia + "'/>";
    close += "</body>";
    above = link.length_m;
  }
  return "<mujoco><option timestep='0.00005' integrator='RK4' gravity='0 " + number(-params.gravity_m_s2) +
         " 0'/><worldbody>" + open + close + "</worldbody></mujoco>";
}

struct Theirs {
  explicit Theirs(const ChainParams& params) {
    const std::string path = testing::TempDir() + "lithe_chain_" + std::to_string(params.links.size()) + ".xml";
    std::ofstream(path) << model_of(params);
    char error[256] = "";
    model.reset(mj_loadXML(path.c_str(), nullptr, error, sizeof error));
    std::remove(path.c_str());
    if (model != nullptr) data.reset(mj_makeData(model.get()));
    why = error;
  }
  std::unique_ptr<mjModel, decltype(&mj_deleteModel)> model{nullptr, mj_deleteModel};
  std::unique_ptr<mjData, decltype(&mj_deleteData)> data{nullptr, mj_deleteData};
  std::string why;
};

ChainParams chain_of(std::size_t count) {
  ChainParams params;
  for (std::size_t i = 0; i < count; ++i) {
    ChainLink link;
    link.length_m = 0.3 - 0.005 * static_cast<double>(i);
    link.center_m = 0.14;
    link.mass_kg = 0.4 - 0.01 * static_cast<double>(i);
    link.inertia_kg_m2 = 3e-3;
    link.rotor_inertia_kg_m2 = 2e-3;
    params.links.push_back(link);
  }
  return params;
}

// One pendulum as a model. The name counts the process in: tests run side by side.
Result<std::unique_ptr<Mechanism>> open_pendulum(Clock clock = monotonic_ns) {
  const std::string path = testing::TempDir() + "lithe_pendulum_" + std::to_string(::getpid()) + ".xml";
  std::ofstream(path) << "<mujoco><worldbody><body><joint name='j' type='hinge' axis='0 0 1'/>"
                         "<geom type='sphere' size='0.1' pos='0 -0.2 0'/></body></worldbody></mujoco>";
  MujocoParams params;
  params.model = path;
  params.joints = {{"j", 0, 1e-3}};
  auto plant = open_mujoco(params, clock);
  std::remove(path.c_str());
  return plant;
}

// Clocks that tell how long ten steps of 50 us took: the same on every processor.
std::int64_t told_ns = 0, asked = 0;
std::int64_t slow_clock() { return told_ns += 10 * 60'000; }
std::int64_t quick_clock() { return told_ns += 10 * 50'000; }
std::int64_t clock_of_a_busy_core() { return told_ns += ++asked == 8 ? 10 * 40'000 : 10 * 900'000; }

TEST(ChainMujoco, AModelThatCannotKeepUpIsRefused) {
  const auto refused = open_pendulum(slow_clock);
  ASSERT_FALSE(refused);
  EXPECT_NE(refused.message().find("a step of 50 us takes 60 us here, it cannot keep up; give a longer step_s"),
            std::string::npos)
      << refused.message();
  EXPECT_TRUE(open_pendulum(quick_clock)) << "it keeps up, if only just";
}

TEST(ChainMujoco, OneQuickBatchOfStepsShowsThatAModelKeepsUp) {
  const auto plant = open_pendulum(clock_of_a_busy_core);
  EXPECT_TRUE(plant) << plant.message();
}

// A tail that never ends would be of denormal numbers, with which every step is slow.
TEST(ChainMujoco, TheTorqueOfAModelsJointEnds) {
  auto plant = open_pendulum();
  ASSERT_TRUE(plant) << plant.message();
  for (int i = 0; i < 100; ++i) (*plant)->step(std::vector<double>{0.5});
  EXPECT_GT((*plant)->torque_nm(0), 0.4);
  for (int i = 0; i < 2 * 20'000; ++i) (*plant)->step(std::vector<double>{0.0});
  EXPECT_EQ((*plant)->torque_nm(0), 0.0);
}

TEST(ChainMujoco, AgreesInAcceleration) {
  std::mt19937 random(9);
  const auto noise = [&] { return static_cast<double>(random() % 2001) / 1000 - 1; };
  for (const std::size_t n : {1U, 2U, 12U}) {
    const ChainParams params = chain_of(n);
    Theirs theirs(params);
    ASSERT_NE(theirs.data, nullptr) << theirs.why;
    for (int round = 0; round < 50; ++round) {
      Chain ours(params);
      std::vector<double> torque(n), before(n);
      for (std::size_t i = 0; i < n; ++i) {
        theirs.data->qpos[i] = 3 * noise();
        theirs.data->qvel[i] = before[i] = 4 * noise();
        theirs.data->qfrc_applied[i] = torque[i] = noise();
        ours.place(i, theirs.data->qpos[i], before[i]);
      }
      mj_forward(theirs.model.get(), theirs.data.get());
      ours.step(torque);
      double largest = 1;
      for (std::size_t i = 0; i < n; ++i) largest = std::max(largest, std::abs(theirs.data->qacc[i]));
      for (std::size_t i = 0; i < n; ++i)
        EXPECT_NEAR((ours.velocity_rad_s(i) - before[i]) / kStepS, theirs.data->qacc[i], 1e-7 * largest) << n;
    }
  }
}

// Let go from the side; both step 50 us, they with Runge-Kutta of the fourth order.
TEST(ChainMujoco, SwingsAlike) {
  for (const std::size_t n : {1U, 2U}) {
    ChainParams params = chain_of(n);
    for (ChainLink& link : params.links) link.joint.viscous_nm_s_rad = 2e-3;
    Theirs theirs(params);
    ASSERT_NE(theirs.data, nullptr) << theirs.why;
    Chain ours(params);
    theirs.data->qpos[0] = 1.0;
    ours.place(0, 1.0);
    double worst = 0;
    for (int step = 0; step < 3 * 20'000; ++step) {
      mj_step(theirs.model.get(), theirs.data.get());
      ours.step({});
      for (std::size_t i = 0; i < n; ++i)
        worst = std::max(worst, std::abs(ours.position_rad(i) - theirs.data->qpos[i]));
    }
    std::printf("%zu links, 3 s: at most %.2g rad apart\n", n, worst);
    EXPECT_LT(worst, 1e-3) << n;
  }
}

#endif

}  // namespace
}  // namespace lithe::hal::sim
