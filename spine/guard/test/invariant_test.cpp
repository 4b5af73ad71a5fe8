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

// Random bits as doubles: NaNs, infinities, denormals and every exponent.
TEST(GuardInvariant, OutputIsFiniteAndWithinLimitsForAnyBitsWhatsoever) {
  std::mt19937_64 random(4);
  Bench bench(robot_with(kMaxJoints));
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
    bench.check();
    for (std::size_t j = 0; j < kMaxJoints; ++j) {
      ASSERT_LE(std::abs(bench.out.torque_nm[j]), 1.0);
      ASSERT_TRUE(std::isnan(bench.out.position_rad[j]) ||
                  (bench.out.position_rad[j] >= -2 && bench.out.position_rad[j] <= 3));
      ASSERT_LE(std::abs(bench.out.velocity_rad_s[j]), 10.0);
      ASSERT_TRUE(bench.out.kp_nm_rad[j] >= 0 && bench.out.kp_nm_rad[j] <= 50);
      ASSERT_TRUE(bench.out.kd_nm_s_rad[j] >= 0 && bench.out.kd_nm_s_rad[j] <= 2);
      ASSERT_TRUE(bench.out.max_torque_nm[j] >= 0 && bench.out.max_torque_nm[j] <= 1);
      ASSERT_LE(std::abs(bench.guard.expected_torque_nm(j)), 1.0);
    }
  }
}

}  // namespace
}  // namespace lithe::guard
