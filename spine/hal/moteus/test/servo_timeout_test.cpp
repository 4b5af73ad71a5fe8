// SPDX-License-Identifier: Apache-2.0
// What a drive does when nobody commands it any more: the last thing between a joint and its fall.
#include <gtest/gtest.h>

#include <cmath>

#include "spine/hal/moteus/sim/servo.hpp"
#include "spine/hal/moteus/test/sim_rig.hpp"

namespace lithe::hal::sim {
namespace {

SimMoteusParams without_friction() {
  SimMoteusParams params = bench_motor();
  params.plant.viscous_nm_s_rad = 0;
  return params;
}

// Speeds up, then is left alone until the watchdog has run out; how fast it is then.
double left_alone(Bench& bench, const Writes& command) {
  EXPECT_GT(bench.stream(command, 100).at(reg::kVelocity), 0.3);
  for (int i = 0; i < 5; ++i) bench.wait_ms(20);
  const Registers tripped = bench.exchange({});
  EXPECT_EQ(tripped.at(reg::kMode), 11);
  return tripped.at(reg::kVelocity);
}

// 0.05 Nm per rev/s against 1e-3 kg m2: a time constant of 2 pi * 1e-3 / 0.05 = 126 ms.
double after_126_ms(Bench& bench) {
  for (int i = 0; i < 3; ++i) bench.wait_ms(42);
  return bench.exchange({}).at(reg::kVelocity);
}

TEST(ServoTimeout, DampsByTheGainScaleOfTheLastCommand) {
  Bench full(without_friction());
  const double from = left_alone(full, with(kTorque, reg::kKdScale, 1));
  EXPECT_NEAR(after_126_ms(full) / from, std::exp(-1), 0.03);
  EXPECT_LT(full.exchange({}).at(reg::kTorque), 0);

  Bench twice(without_friction());
  const double twice_from = left_alone(twice, with(kTorque, reg::kKdScale, 2));
  EXPECT_NEAR(after_126_ms(twice) / twice_from, std::exp(-2), 0.03);
}

TEST(ServoTimeout, AHostThatCommandsNoDampingLeavesALimpJoint) {
  Bench bench(without_friction());
  const double from = left_alone(bench, kTorque);
  EXPECT_NEAR(after_126_ms(bench) / from, 1, 0.02);
  EXPECT_EQ(bench.exchange({}).at(reg::kTorque), 0);
  // Latched, but it hears: the scale of a later command counts.
  bench.exchange(with(kTorque, reg::kKdScale, 1));
  const double heard = bench.exchange({}).at(reg::kVelocity);
  EXPECT_EQ(bench.exchange({}).at(reg::kMode), 11);
  EXPECT_NEAR(after_126_ms(bench) / heard, std::exp(-1), 0.03);
}

TEST(ServoTimeout, ZeroVelocityDampsByItsOwnScale) {
  for (const double scale : {0.0, 1.0, 2.0}) {
    Bench bench(without_friction());
    ASSERT_GT(bench.stream(kTorque, 100).at(reg::kVelocity), 0.3);
    bench.exchange({{reg::kMode, 12}, {reg::kKdScale, scale}});
    const double from = bench.exchange({}).at(reg::kVelocity);
    EXPECT_NEAR(after_126_ms(bench) / from, std::exp(-scale), 0.03) << scale;
  }
}

TEST(ServoTimeout, DampingIsLimitedAsTheDriveIsSet) {
  SimMoteusParams params = without_friction();
  params.servo.timeout_max_torque_nm = 0.01;
  Bench bench(params);
  left_alone(bench, kTorque);
  bench.exchange(with(kTorque, reg::kKdScale, 100));
  bench.wait_ms(20);
  EXPECT_NEAR(bench.exchange({}).at(reg::kTorque), -0.01, 1e-3);
}

TEST(ServoTimeout, TheOtherModesAreAsTheDriveIsSet) {
  for (const double mode : {0.0, 10.0, 15.0, 7.0}) {
    SimMoteusParams params = without_friction();
    params.servo.timeout_mode = mode;
    Bench bench(params);
    const double from = left_alone(bench, kTorque);
    const double left = after_126_ms(bench) / from;
    const double most = mode == 10 ? 0.9 : mode == 15 ? 0.3 : 1.02;  // held by its own gains; shorted; free
    const double least = mode == 10 || mode == 15 ? -1 : 0.98;
    EXPECT_TRUE(least < left && left < most) << "mode " << mode << ": " << left;
  }
}

TEST(ServoHome, IsWhatPowerOnGivesUntilAnOutputIsSetOrAReindexIsAskedFor) {
  SimMoteusParams params = bench_motor();
  params.servo.home_at_power_on = 1;
  Bench bench(params);
  const auto home = [&bench] { return bench.exchange({}, {reg::kHomeState}).at(reg::kHomeState); };
  EXPECT_EQ(home(), 1);
  bench.exchange({{reg::kSetOutputNearest, 0.25}});
  EXPECT_EQ(home(), 2);
  bench.exchange({{reg::kRequireReindex, 1}});
  EXPECT_EQ(home(), 0);
  bench.exchange({{reg::kSetOutputExact, 0.25}});
  EXPECT_EQ(home(), 2);
  bench.drive().servo().set_encoder_lost(true);
  EXPECT_EQ(home(), 0);
  bench.drive().servo().set_encoder_lost(false);
  bench.drive().restart(0);
  EXPECT_EQ(home(), 1) << "what was set is forgotten without power";
}

}  // namespace
}  // namespace lithe::hal::sim
