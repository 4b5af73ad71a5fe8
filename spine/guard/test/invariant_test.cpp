// SPDX-License-Identifier: Apache-2.0
// Invariants of the guard for any input.
#include <gtest/gtest.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <random>

#include "spine/guard/test/guard_rig.hpp"

namespace lithe::guard {
namespace {

using wire::Mode;

// Runs `step` on random proposals. Returns the largest change of torque from one sent command to the next, both
// computed for the state of the joint at the change. Only with a usable sample: without one, the drive alone
// determines the torque. The bus is sometimes late.
template <class Step>
double largest_step_nm(Step step) {
  std::mt19937_64 random(3);
  std::uniform_real_distribution<double> wild(-5, 5);
  Output sent;  // the last one that was sent
  bool was_blind = false, comparable = true;
  double largest = 0;
  Bench bench;
  for (int i = 0; i < 20'000; ++i) {
    bench.torque[0] = wild(random);
    bench.position[0] = 0.7 * wild(random);
    bench.velocity[0] = 2.4 * wild(random);
    bench.position_target[0] = random() % 3 == 0 ? kNan : wild(random);
    bench.velocity_target[0] = wild(random);
    bench.kp[0] = 10 * wild(random);
    bench.kd[0] = wild(random);
    bench.stale_ticks = random() % 40 == 0 ? 25 : 0;
    if (random() % 50 == 0) bench.torque[0] = kNan;
    bench.mode = random() % 100 == 0 ? Mode::safe_stop : Mode::active;
    const bool blind = bench.stale_ticks > 0;
    const bool bus_in_time = random() % 10 != 0;
    if (bus_in_time) {
      comparable = !was_blind;
      sent = bench.out;
    }
    step(bench, bus_in_time);
    if (comparable && !blind) largest = std::max(largest, std::abs(bench.felt_nm() - bench.felt_nm(sent, 0)));
    was_blind = blind;
  }
  return largest;
}

TEST(GuardInvariant, NoProposalFaultOrSwapEverStepsTheTorqueBeyondTheSlewBound) {
  const double step = largest_step_nm([](Bench& bench, bool bus_in_time) { bench.check(bus_in_time); });
  EXPECT_LE(step, kSlewPerTick + 1e-9);
  EXPECT_GT(step, 0.9 * kSlewPerTick);
}

TEST(GuardInvariant, ATwinThatTakesEveryOutputForDispatchedIsCaughtStepping) {
  const double step = largest_step_nm([](Bench& bench, bool) { bench.check(true); });
  EXPECT_GT(step, 1.9 * kSlewPerTick);
}

TEST(GuardInvariant, ATwinThatOnlyClampsIsCaughtStepping) {
  const double step = largest_step_nm([](Bench& bench, bool) {
    bench.out.torque_nm[0] = std::isfinite(bench.torque[0]) ? std::clamp(bench.torque[0], -1.0, 1.0) : 0.0;
  });
  EXPECT_GT(step, 10 * kSlewPerTick);
}

// A chain of links of 0.3 kg, as a robot file with a model gives it.
robot::RobotConfig robot_with_model(std::size_t joints) {
  robot::RobotConfig robot = robot_with(joints);
  robot.model.given = true;
  robot.devices.resize(joints);
  for (std::size_t j = 0; j < joints; ++j) {
    robot.joints[j].device = j;
    robot::JointModel& model = robot.joints[j].model;
    model.given = true;
    model.link = {.parent = j == 0 ? mechanics::Link::kBase : j - 1,
                  .offset_m = {0, 0, -0.1},
                  .mass_kg = 0.3,
                  .center_m = {0, 0.02, -0.05},
                  .rotor_kg_m2 = 1e-3};
    model.link.axis = j % 2 == 0 ? mechanics::Vector{0, 1, 0} : mechanics::Vector{1, 0, 0};
    model.allotted_rad_s2 = 5;
    model.kp_most_nm_rad = 50;
    model.kd_most_nm_s_rad = 2;
  }
  return robot;
}

// Random bits as doubles: NaNs, infinities, denormals and every exponent.
void expect_within_limits_for_any_bits(const robot::RobotConfig& robot, double velocity_max_rad_s) {
  std::mt19937_64 random(4);
  Bench bench(robot);
  const auto noise = [&](JointArray& values) {
    for (double& value : values)
      value = random() % 2 == 0 ? std::bit_cast<double>(random()) : static_cast<double>(random() % 2000) / 500 - 2;
  };
  for (int i = 0; i < 20'000; ++i) {
    for (JointArray* values : {&bench.torque, &bench.velocity_target, &bench.kp, &bench.kd}) noise(*values);
    noise(bench.position_target);
    if (i % 3 == 0) noise(bench.position);
    if (i % 5 == 0) noise(bench.velocity);
    if (i % 3 == 1) bench.position.fill(0.5);
    if (i % 5 == 1) bench.velocity.fill(-1);
    if (i % 7 == 0) bench.torque.fill(0.1);
    bench.mode = static_cast<Mode>(random() % 6);
    bench.stale_ticks = static_cast<std::uint32_t>(random() % 30);
    bench.brain_age_ns = static_cast<std::int64_t>(random());
    if (i % 11 == 0) bench.guard.forget_faults();
    if (i % 13 == 0) bench.guard.reset_output();
    bench.check();
    for (std::size_t j = 0; j < robot.joints.size(); ++j) {
      ASSERT_LE(std::abs(bench.out.torque_nm[j]), 1.0);
      ASSERT_TRUE(std::isnan(bench.out.position_rad[j]) ||
                  (bench.out.position_rad[j] >= -2 && bench.out.position_rad[j] <= 3));
      ASSERT_LE(std::abs(bench.out.velocity_rad_s[j]), velocity_max_rad_s);
      ASSERT_TRUE(bench.out.kp_nm_rad[j] >= 0 && bench.out.kp_nm_rad[j] <= 50);
      ASSERT_TRUE(bench.out.kd_nm_s_rad[j] >= 0 && bench.out.kd_nm_s_rad[j] <= 2);
      ASSERT_TRUE(bench.out.max_torque_nm[j] >= 0 && bench.out.max_torque_nm[j] <= 1);
      ASSERT_LE(std::abs(bench.guard.expected_torque_nm(j)), 1.0);
    }
  }
}

TEST(GuardInvariant, OutputIsFiniteAndWithinLimitsForAnyBitsWhatsoever) {
  expect_within_limits_for_any_bits(robot_with(kMaxJoints), 10);
}

// The damping that a drive adds is told around the speed that the guard predicts: up to three times what is a fault.
TEST(GuardInvariant, OutputIsFiniteAndWithinLimitsWithAModelForAnyBitsWhatsoever) {
  for (const std::size_t joints : {1, 3, 7}) {
    const robot::RobotConfig robot = robot_with_model(joints);
    expect_within_limits_for_any_bits(robot, 3 * 10 * robot.guard.velocity_overrun);
  }
}

}  // namespace
}  // namespace lithe::guard
