// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/physics/coupling.hpp"
#include "spine/core/test/units_rig.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <memory>
#include <vector>

#include "spine/hal/cia402/sim/cia402_servo.hpp"
#include "spine/hal/moteus/sim/servo.hpp"
#include "spine/hal/physics/chain.hpp"

namespace lithe::hal::sim {
namespace {

using moteus::Mode;

ChainParams two_links() {
  ChainLink link;
  link.length_m = 0.15;
  link.mass_kg = 0.05;
  link.center_m = 0.1;
  link.inertia_kg_m2 = 2e-4;
  link.rotor_inertia_kg_m2 = 5.6e-5;
  link.joint.viscous_nm_s_rad = 1e-3;
  return {9.81, {link, link}};
}

ServoCommand hold_at(double position_rev) {
  ServoCommand command;
  command.position_rev = position_rev;
  command.velocity_limit_rev_s = 0.5;
  command.watchdog_s = 1000;
  return command;
}

// A robot of moteus drives on one chain.
struct Arm {
  explicit Arm(const ChainParams& params) : coupling(std::make_unique<Chain>(params)) {
    for (std::size_t i = 0; i < params.links.size(); ++i) {
      servos.push_back(std::make_unique<Servo>(ServoParams{}, JointTransform{}, params.links[i].joint));
      EXPECT_TRUE(coupling.add(*servos.back()));
    }
    coupling.advance(0);
  }
  void run(std::int64_t until_ns) {
    while (now_ns < until_ns) coupling.advance(now_ns += kMs);
  }
  Coupling coupling;
  std::vector<std::unique_ptr<Servo>> servos;
  std::int64_t now_ns = 0;
};

TEST(Coupling, OneDriveThatMovesMovesTheOther) {
  Arm arm(two_links());
  arm.servos[0]->apply(Mode::position, hold_at(0.25));
  double farthest_rad = 0;
  for (int ms = 1; ms <= 3000; ++ms) {
    arm.run(ms * kMs);
    farthest_rad = std::max(farthest_rad, std::abs(arm.coupling.mechanism().position_rad(1)));
  }
  EXPECT_GT(farthest_rad, 0.05) << "swung along";
  EXPECT_EQ(arm.servos[1]->mode(), Mode::stopped);
  const double read_rad = arm.servos[1]->position_rev() * 2 * 3.14159265358979;
  EXPECT_NEAR(read_rad, arm.coupling.mechanism().position_rad(1), 1e-3) << "its encoder shows it";
}

TEST(Coupling, ADriveHoldsTheWeightOfAllThatHangsOnItsJoint) {
  const ChainParams params = two_links();
  Arm arm(params);
  for (const auto& servo : arm.servos) servo->apply(Mode::position, hold_at(0));
  arm.servos[0]->apply(Mode::position, hold_at(0.25));
  arm.run(8000 * kMs);
  const double first_rad = arm.coupling.mechanism().position_rad(0);
  const double both_rad = first_rad + arm.coupling.mechanism().position_rad(1);
  const double outer_nm = 0.05 * 9.81 * 0.1 * std::sin(both_rad);
  const double inner_nm = 0.05 * 9.81 * (0.1 + 0.15) * std::sin(first_rad) + outer_nm;
  EXPECT_NEAR(arm.servos[0]->plant().torque_nm(), inner_nm, 2e-3);
  EXPECT_NEAR(arm.servos[1]->plant().torque_nm(), outer_nm, 2e-3);
}

TEST(Coupling, OneLinkUnderADriveEndsWhereItsOwnPlantWould) {
  ChainParams params = two_links();
  params.links.pop_back();
  Arm arm(params);
  PlantParams plant = params.links[0].joint;
  plant.mgl_nm = 0.05 * 9.81 * 0.1;
  plant.inertia_kg_m2 = 2e-4 + 0.05 * 0.01 + 5.6e-5;
  Servo alone(ServoParams{}, JointTransform{}, plant);
  alone.advance(0);
  arm.servos[0]->apply(Mode::position, hold_at(0.2));
  alone.apply(Mode::position, hold_at(0.2));
  double worst_rad = 0;
  for (int ms = 1; ms <= 5000; ++ms) {
    arm.run(ms * kMs);
    alone.advance(ms * kMs);
    worst_rad = std::max(worst_rad, std::abs(alone.plant().position_rad() - arm.coupling.mechanism().position_rad(0)));
  }
  EXPECT_LT(worst_rad, 0.02) << "50 us later on the way";
  EXPECT_NEAR(alone.plant().position_rad(), arm.coupling.mechanism().position_rad(0), 1e-3);
}

TEST(Coupling, HowOftenItIsCalledChangesNothing) {
  Arm often(two_links());
  Arm seldom(two_links());
  for (Arm* arm : {&often, &seldom}) arm->servos[0]->apply(Mode::position, hold_at(0.1));
  for (std::int64_t now_ns = 0; now_ns <= 500 * kMs; now_ns += kMs / 4) often.coupling.advance(now_ns);
  for (std::int64_t now_ns = 0; now_ns <= 500 * kMs; now_ns += 10 * kMs) seldom.coupling.advance(now_ns);
  for (std::size_t i = 0; i < 2; ++i)
    EXPECT_EQ(often.coupling.mechanism().position_rad(i), seldom.coupling.mechanism().position_rad(i));
}

TEST(Coupling, AfterALongPauseItGoesOnAndWatchdogsHaveRun) {
  Arm arm(two_links());
  ServoCommand command = hold_at(0.1);
  command.watchdog_s = 0.2;
  arm.servos[0]->apply(Mode::position, command);
  arm.run(50 * kMs);
  EXPECT_EQ(arm.servos[0]->mode(), Mode::position);
  arm.coupling.advance(10'000 * kMs);
  arm.coupling.advance(10'001 * kMs);
  EXPECT_EQ(arm.servos[0]->mode(), Mode::timeout);
  EXPECT_TRUE(std::isfinite(arm.coupling.mechanism().position_rad(1)));
  arm.coupling.advance(3 * kMs);  // backwards
}

// While nothing moves, no set-point runs away from its joint.
TEST(Coupling, WhatALongPauseSkipsIsSkippedForTheDrivesToo) {
  Arm arm(two_links());
  arm.servos[0]->apply(Mode::position, hold_at(10));
  arm.run(100 * kMs);
  const double before_rev = arm.servos[0]->control_position_rev();
  EXPECT_GT(before_rev, 0.01) << "on its way at half a turn a second";
  arm.coupling.advance(10'000 * kMs);
  EXPECT_NEAR(arm.servos[0]->control_position_rev() - before_rev, 0.5 * 0.050, 1e-4) << "50 ms are made up for";
  Cia402Servo other(Cia402ServoParams{}, JointTransform{}, PlantParams{});
  other.advance(0);
  other.skip(1000 * kMs);
  other.skip(5 * kMs);  // backwards
  EXPECT_EQ(other.position(), 0);
}

TEST(Cia402Servo, AJointThatIsNowhereReadsZero) {
  Cia402Servo servo(Cia402ServoParams{}, JointTransform{}, PlantParams{});
  servo.plant().couple();
  servo.advance(0);
  servo.plant().follow(NAN, NAN, NAN);
  servo.advance(kMs);
  EXPECT_EQ(servo.position(), 0);
  EXPECT_EQ(servo.velocity(), 0);
  EXPECT_EQ(servo.torque(), 0);
}

TEST(Coupling, AChainTakesNoMoreDrivesThanItHasJoints) {
  ChainParams params = two_links();
  Arm arm(params);
  Servo third(ServoParams{}, JointTransform{}, PlantParams{});
  EXPECT_FALSE(arm.coupling.add(third));
}

}  // namespace
}  // namespace lithe::hal::sim
