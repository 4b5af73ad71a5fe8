// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/physics/truth.hpp"
#include "spine/core/test/units_rig.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "spine/hal/cia402/sim/cia402_servo.hpp"
#include "spine/hal/moteus/sim/servo.hpp"
#include "spine/hal/physics/plant.hpp"

namespace lithe::hal::sim {
namespace {

using moteus::Mode;

constexpr std::int64_t kStartNs = 1'000 * kMs;

ServoCommand torque_command(double torque_nm) {
  ServoCommand command;
  command.position_rev = ServoParams::kNone;
  command.torque_nm = torque_nm;
  command.kp_scale = command.kd_scale = 0;
  command.watchdog_s = 100;
  command.velocity_limit_rev_s = command.acceleration_limit_rev_s2 = -1;
  return command;
}

// A drive that is on; the joint is heavy, so that it hardly moves.
Servo driven(const DriveErrors& errors) {
  PlantParams plant;
  plant.inertia_kg_m2 = 1e3;
  Servo servo({}, {}, plant, errors);
  servo.advance(kStartNs);
  servo.apply(Mode::position, torque_command(0));
  servo.advance(kStartNs + 20 * kMs);
  EXPECT_EQ(servo.mode(), Mode::position);
  return servo;
}

TEST(Draws, AreTheSameForTheSameSeedAndNormalOnesHaveTheDeviationTheySay) {
  Draws one(7), same(7), other(8);
  double sum = 0, squares = 0, most = 0;
  bool differ = false;
  constexpr int kCount = 100'000;
  for (int i = 0; i < kCount; ++i) {
    const double x = one.normal();
    EXPECT_EQ(x, same.normal());
    differ = differ || x != other.normal();
    sum += x;
    squares += x * x;
    most = std::max(most, std::abs(x));
  }
  EXPECT_TRUE(differ);
  EXPECT_NEAR(sum / kCount, 0, 0.02);
  EXPECT_NEAR(std::sqrt(squares / kCount), 1, 0.01);
  EXPECT_LT(most, 3.47);
}

TEST(DriveErrors, ADriveWithAWrongTorqueConstantTellsWhatItMeansAndTheJointGetsMore) {
  Servo servo = driven({.torque_gain = 0.05});
  servo.apply(Mode::position, torque_command(0.2));
  servo.advance(kStartNs + 60 * kMs);
  EXPECT_NEAR(servo.torque_nm(), 0.2, 1e-9);
  EXPECT_NEAR(servo.plant().torque_nm(), 0.21, 1e-9);
}

TEST(DriveErrors, TheNoiseOfToldTorquesAndReadAnglesIsAsLargeAsItIsSaid) {
  Servo servo = driven({.torque_noise_nm = 0.002, .encoder_noise_rad = 2e-3, .encoder_offset_rad = 0.1});
  double angle = 0, angles = 0, torques = 0;
  constexpr int kCount = 4'000;
  for (int i = 1; i <= kCount; ++i) {
    servo.advance(kStartNs + 20 * kMs + i * Plant::kStepNs);
    const double read_rad = servo.position_rev() * 2 * std::numbers::pi - servo.plant().position_rad();
    angle += read_rad;
    angles += read_rad * read_rad;
    torques += servo.torque_nm() * servo.torque_nm();
  }
  const double mean_rad = angle / kCount;
  EXPECT_NEAR(mean_rad, 0.1, 5e-4);
  EXPECT_NEAR(std::sqrt(angles / kCount - mean_rad * mean_rad), 2e-3, 1e-4);
  EXPECT_NEAR(std::sqrt(torques / kCount), 0.002, 1e-4);
}

TEST(DriveErrors, ACommandActsAfterTheDelayOfTheBusAndNoneIsLost) {
  Servo servo = driven({.delay_ns = 250'000});
  const std::int64_t sent_ns = kStartNs + 20 * kMs;
  servo.apply(Mode::position, torque_command(0.2));
  servo.advance(sent_ns + 250'000);
  EXPECT_EQ(servo.plant().torque_nm(), 0) << "until then it is on its way";
  servo.apply(Mode::position, torque_command(0.3));  // before the first one has acted
  servo.advance(sent_ns + 300'000);
  EXPECT_NEAR(servo.control_torque_nm(), 0.2, 1e-12);
  servo.advance(sent_ns + 600'000);
  EXPECT_NEAR(servo.control_torque_nm(), 0.3, 1e-12);
}

// As a drive does that answers a frame when it has obeyed it: the reply to a stop says `stopped`.
TEST(DriveErrors, AnotherModeIsToldAtOnceAndNothingUnderwayUndoesIt) {
  Servo servo = driven({.delay_ns = 250'000});
  servo.apply(Mode::position, torque_command(0.2));
  servo.apply(Mode::stopped, {});
  EXPECT_EQ(servo.mode(), Mode::stopped);
  servo.advance(kStartNs + 30 * kMs);
  EXPECT_EQ(servo.mode(), Mode::stopped);
}

TEST(DriveErrors, MoreCommandsThanFitOnTheirWayActInTheirOrder) {
  Servo servo = driven({.delay_ns = kMs});
  for (int i = 1; i <= 100; ++i) servo.apply(Mode::position, torque_command(0.001 * i));
  servo.advance(kStartNs + 30 * kMs);
  EXPECT_NEAR(servo.control_torque_nm(), 0.1, 1e-12);
}

TEST(DriveErrors, ATorqueOfACanopenDriveIsDelayedAndWrongLikewise) {
  PlantParams plant;
  plant.inertia_kg_m2 = 1e3;
  Cia402Servo servo({}, {}, plant, {.torque_gain = -0.05, .delay_ns = 250'000});
  servo.advance(kStartNs);
  Cia402Inputs inputs;
  inputs.mode = cia402::Mode::torque;
  servo.set_inputs(inputs);
  std::int64_t now_ns = kStartNs;
  for (const std::uint16_t word : {std::uint16_t{0x06}, std::uint16_t{0x07}, std::uint16_t{0x0f}}) {
    servo.control(word);
    servo.advance(now_ns += kMs / 2);
  }
  servo.advance(kStartNs + 3 * kMs);
  ASSERT_EQ(servo.state(), cia402::State::operation_enabled);
  inputs.target_torque = 200;
  servo.set_inputs(inputs);
  servo.advance(kStartNs + 3 * kMs + 250'000);
  EXPECT_EQ(servo.plant().torque_nm(), 0);
  servo.advance(kStartNs + 4 * kMs);
  EXPECT_NEAR(servo.plant().torque_nm(), 0.19, 1e-9);
  EXPECT_EQ(servo.torque(), 200);
}

TEST(Stribeck, AJointAtRestIsHeldHarderThanOneThatMoves) {
  PlantParams params;
  params.coulomb_nm = 0.1;
  params.stribeck_nm = 0.05;
  Plant plant(params);
  for (int i = 0; i < 1000; ++i) plant.step(0.149);
  EXPECT_EQ(plant.velocity_rad_s(), 0);
  for (int i = 0; i < 8000; ++i) plant.step(0.151);
  EXPECT_GT(plant.velocity_rad_s(), 0.5) << "once it moves, much less is left";
  EXPECT_NEAR(dry_friction_nm(0.1, 0.05, 0.1, 0.1), 0.1 + 0.05 / std::numbers::e, 1e-12);
  EXPECT_EQ(dry_friction_nm(0.1, 0.05, 0.1, 5), 0.1);
}

robot::RobotConfig one_joint() {
  robot::RobotConfig config;
  config.devices.emplace_back();
  robot::JointConfig& joint = config.joints.emplace_back();
  joint.name = "shoulder";
  joint.sim.mgl_nm = 0.165;
  joint.sim.inertia_kg_m2 = 2.55e-3;
  joint.sim.cogging_nm = 0.01;
  joint.sim.stribeck_nm = 0.004;
  joint.sim.payload_kg = 0.1;
  joint.sim.payload_m = 0.2;
  joint.sim.torque_gain_error = 0.05;
  joint.sim.encoder_offset_rad = 0.01;
  joint.sim.torque_noise_nm = 0.002;
  joint.sim.encoder_noise_rad = 1e-3;
  joint.sim.bus_delay_s = 0.00026;
  return config;
}

TEST(Truth, IsDrawnByTheSeedWithinWhatTheFileSays) {
  robot::RobotConfig config = one_joint();
  double least = 1, most = -1;
  for (std::uint64_t seed = 0; seed < 200; ++seed) {
    config.joints[0].sim.seed = seed;
    const Truth truth = draw_truth(config, config.joints[0]);
    ASSERT_LE(std::abs(truth.drive.torque_gain), 0.05);
    ASSERT_LE(std::abs(truth.drive.encoder_offset_rad), 0.01);
    ASSERT_GE(truth.payload_kg, 0);
    ASSERT_LE(truth.payload_kg, 0.1);
    ASSERT_EQ(truth.drive.delay_ns, 250'000) << "whole steps";
    ASSERT_NEAR(truth.plant.mgl_nm, 0.165 + truth.payload_kg * 9.81 * 0.2, 1e-12);
    ASSERT_NEAR(truth.plant.inertia_kg_m2, 2.55e-3 + truth.payload_kg * 0.04, 1e-12);
    ASSERT_DOUBLE_EQ(truth.mgl_told_nm, truth.plant.mgl_nm / (1 + truth.drive.torque_gain));
    ASSERT_EQ(draw_truth(config, config.joints[0]).mgl_told_nm, truth.mgl_told_nm);
    least = std::min(least, truth.drive.torque_gain);
    most = std::max(most, truth.drive.torque_gain);
  }
  EXPECT_LT(least, -0.045);
  EXPECT_GT(most, 0.045);
}

TEST(Truth, JointsOfOneSeedDiffer) {
  robot::RobotConfig config = one_joint();
  robot::JointConfig other = config.joints[0];
  other.name = "elbow";
  EXPECT_NE(draw_truth(config, config.joints[0]).drive.torque_gain, draw_truth(config, other).drive.torque_gain);
}

TEST(Truth, AnIdealRobotHasNoErrors) {
  robot::RobotConfig config = one_joint();
  config.plant.ideal = true;
  const Truth truth = draw_truth(config, config.joints[0]);
  EXPECT_EQ(truth.drive.torque_gain, 0);
  EXPECT_EQ(truth.drive.encoder_noise_rad, 0);
  EXPECT_EQ(truth.drive.delay_ns, 0);
  EXPECT_EQ(truth.plant.cogging_nm, 0);
  EXPECT_EQ(truth.plant.stribeck_nm, 0);
  EXPECT_EQ(truth.mgl_told_nm, 0.165);
}

TEST(Truth, APayloadOnALinkMovesItsCentreAndKeepsItsMomentAboutTheJoint) {
  robot::RobotConfig config = one_joint();
  config.plant.kind = robot::PlantKind::chain;
  robot::PlantConfig& sim = config.joints[0].sim;
  sim.length_m = 0.3;
  sim.mass_kg = 0.2;
  sim.center_m = 0.1;
  sim.link_inertia_kg_m2 = 1e-3;
  const Truth truth = draw_truth(config, config.joints[0]);
  const robot::PlantConfig& link = truth.plant;
  EXPECT_NEAR(link.mass_kg, 0.2 + truth.payload_kg, 1e-12);
  EXPECT_NEAR(link.mass_kg * link.center_m, 0.2 * 0.1 + truth.payload_kg * 0.2, 1e-12);
  EXPECT_NEAR(link.link_inertia_kg_m2 + link.mass_kg * link.center_m * link.center_m,
              1e-3 + 0.2 * 0.01 + truth.payload_kg * 0.04, 1e-12);
}

}  // namespace
}  // namespace lithe::hal::sim
