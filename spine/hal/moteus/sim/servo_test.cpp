// SPDX-License-Identifier: Apache-2.0
// Every rule of the drive's modes, watchdog, limits and control law that a host can run into, seen through frames.
#include "spine/hal/moteus/sim/servo.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "spine/hal/moteus/test/sim_rig.hpp"

namespace lithe::hal::sim {
namespace {

// ---- modes

TEST(Servo, TheAnswerTellsTheStateBeforeTheCommand) {
  Bench bench;
  EXPECT_EQ(bench.exchange(kTorque).at(reg::kMode), 0);
  EXPECT_NE(bench.exchange({}).at(reg::kMode), 0);
}

TEST(Servo, StoppedPassesThroughCalibrationForSomeMilliseconds) {
  Bench bench;
  bench.exchange(kTorque);
  std::vector<Mode> seen;
  for (int i = 0; i < 400; ++i) {
    const Mode mode = bench.mode();
    if (seen.empty() || seen.back() != mode) seen.push_back(mode);
    for (int step = 0; step < 1; ++step) bench.drive().servo().advance(bench.drive().servo().time_ns() + 50'000);
  }
  EXPECT_EQ(seen, (std::vector<Mode>{Mode::enabling, Mode::calibrating, Mode::calibration_complete, Mode::position}));
}

TEST(Servo, DuringCalibrationANewCommandOnlyReplacesTheTarget) {
  Bench bench;
  bench.exchange(kTorque);
  bench.wait_ms(2);
  EXPECT_EQ(bench.mode(), Mode::calibrating);
  bench.exchange({{reg::kMode, 12}});
  EXPECT_EQ(bench.mode(), Mode::calibrating);
  bench.wait_ms(10);
  EXPECT_EQ(bench.mode(), Mode::zero_velocity);
}

TEST(Servo, WritingTheModeResetsEveryCommandRegister) {
  Bench bench;
  const std::vector<std::uint32_t> reads{reg::kCommandPosition, reg::kCommandTorque, reg::kKpScale, reg::kWatchdog};
  bench.exchange({{reg::kCommandPosition, 0.5}, {reg::kCommandTorque, 0.2}, {reg::kKpScale, 0.1}, {reg::kWatchdog, 3}});
  auto r = bench.exchange({}, reads);
  EXPECT_FLOAT_EQ(static_cast<float>(r.at(reg::kCommandTorque)), 0.2F);
  bench.exchange(kStop);
  r = bench.exchange({}, reads);
  EXPECT_EQ(r.at(reg::kCommandPosition), 0);
  EXPECT_EQ(r.at(reg::kCommandTorque), 0);
  EXPECT_EQ(r.at(reg::kKpScale), 1);
  EXPECT_EQ(r.at(reg::kWatchdog), 0);
  r = bench.exchange({}, {reg::kMaxTorque, reg::kStopPosition, reg::kVelocityLimit, reg::kAccelerationLimit});
  for (const auto& [number, value] : r) EXPECT_TRUE(std::isnan(value)) << number;
}

TEST(Servo, CommandRegistersWithoutAModeAreKeptButNotApplied) {
  Bench bench;
  bench.stream(with(kTorque, reg::kWatchdog, kNan), 10);
  bench.exchange({{reg::kCommandTorque, -0.5}});
  bench.wait_ms(1);
  EXPECT_FLOAT_EQ(static_cast<float>(bench.exchange({}, {reg::kCommandTorque}).at(reg::kCommandTorque)), -0.5F);
  EXPECT_NEAR(bench.exchange({}, {reg::kTorque}).at(reg::kTorque), 0.05, 1e-6);
}

TEST(Servo, ModesOneToFourAreIgnoredAndSixteenIsAnError) {
  Bench bench;
  for (const double mode : {1.0, 2.0, 3.0, 4.0}) {
    bench.exchange({{reg::kMode, mode}});
    EXPECT_EQ(bench.mode(), Mode::stopped);
    EXPECT_NE(bench.last().data[0], 0x30);
  }
  bench.exchange({{reg::kMode, 16}}, {});
  const std::array<std::uint8_t, 3> error{0x30, 0x00, 0x01};
  for (std::size_t i = 0; i < error.size(); ++i) EXPECT_EQ(bench.last().data[i], error[i]);
  EXPECT_EQ(bench.mode(), Mode::stopped);
}

// ---- watchdog

TEST(Servo, WithoutCommandsTheWatchdogLatchesTheTimeoutMode) {
  Bench bench;
  bench.stream(with(kTorque, reg::kWatchdog, 0.05), 50);
  EXPECT_EQ(bench.mode(), Mode::position);
  bench.wait_ms(48);
  EXPECT_EQ(bench.mode(), Mode::position) << "a query is no command, and 49 ms are not 50";
  bench.wait_ms(2);
  EXPECT_EQ(bench.mode(), Mode::timeout);
  bench.stream(kTorque, 20);
  EXPECT_EQ(bench.mode(), Mode::timeout) << "latched";
  bench.exchange(kStop);
  EXPECT_EQ(bench.mode(), Mode::stopped);
}

TEST(Servo, TheConfiguredWatchdogIsATenthOfASecondAndNanIsNone) {
  Bench bench;
  bench.stream(kTorque, 10);
  bench.wait_ms(97);
  EXPECT_EQ(bench.mode(), Mode::position);
  bench.wait_ms(4);
  EXPECT_EQ(bench.mode(), Mode::timeout);
  bench.exchange(kStop);
  bench.stream(with(kTorque, reg::kWatchdog, kNan), 10);
  for (int i = 0; i < 100; ++i) bench.wait_ms(40);
  EXPECT_EQ(bench.mode(), Mode::position);
}

TEST(Servo, ModesOtherThanPositionAndWithinHaveNoWatchdog) {
  for (const double mode : {9.0, 12.0, 15.0}) {
    Bench bench;
    bench.stream({{reg::kMode, mode}, {reg::kWatchdog, 0.01}}, 10);
    for (int i = 0; i < 20; ++i) bench.wait_ms(40);
    EXPECT_EQ(bench.mode(), static_cast<Mode>(mode));
  }
  Bench bench;
  bench.stream({{reg::kMode, 13}, {reg::kWatchdog, 0.01}}, 10);
  bench.wait_ms(12);
  EXPECT_EQ(bench.mode(), Mode::timeout);
}

TEST(Servo, ALongSilenceTripsTheWatchdogEvenWhenThePlantSkipsThatTime) {
  Bench bench;
  bench.stream(with(kTorque, reg::kWatchdog, 0.2), 20);
  bench.wait_ms(5000);
  EXPECT_EQ(bench.mode(), Mode::timeout);
  Bench other;  // waits for as long as one advance() simulates
  other.stream(with(kTorque, reg::kWatchdog, 0.2), 20);
  other.wait_ms(50);
  EXPECT_EQ(bench.drive().servo().position_rev(), other.drive().servo().position_rev());
}

// ---- faults and limits

TEST(Servo, StartingOutsideTheBoundsIsFault39AndOnlyAStopClearsIt) {
  SimMoteusParams params = bench_motor();
  params.servo.position_min_rev = -0.01;
  params.servo.position_max_rev = 0.01;
  params.plant.initial_position_rad = 0.02 * kTurn;
  Bench bench(params);
  Registers r = bench.stream(kTorque, 10);
  EXPECT_EQ(r.at(reg::kMode), 1);
  EXPECT_EQ(r.at(reg::kFault), 39);
  EXPECT_EQ(bench.stream(kTorque, 10).at(reg::kMode), 1);
  EXPECT_EQ(bench.stream({{reg::kMode, 12}}, 10).at(reg::kMode), 1);
  r = bench.stream(kStop, 2);
  EXPECT_EQ(r.at(reg::kMode), 0);
  EXPECT_EQ(r.at(reg::kFault), 0);
  EXPECT_EQ(bench.stream(with(kTorque, reg::kIgnoreBounds, 1), 10).at(reg::kMode), 10);
}

TEST(Servo, AStopPositionTogetherWithAPlannerIsFault45) {
  Bench bench;
  Registers r = bench.stream({{reg::kMode, 10}, {reg::kStopPosition, 0.5}}, 10);
  EXPECT_EQ(r.at(reg::kFault), 45) << "the configured acceleration limit already plans";
  bench.exchange(kStop);
  r = bench.stream({{reg::kMode, 10},
                    {reg::kCommandPosition, kNan},
                    {reg::kCommandVelocity, 1},
                    {reg::kStopPosition, 0.1},
                    {reg::kVelocityLimit, -1},
                    {reg::kAccelerationLimit, -1},
                    {reg::kWatchdog, kNan}},
                   1);
  for (int i = 0; i < 50; ++i) bench.wait_ms(40);
  r = bench.exchange({}, {reg::kMode, reg::kControlPosition, reg::kControlVelocity});
  EXPECT_EQ(r.at(reg::kMode), 10);
  EXPECT_NEAR(r.at(reg::kControlPosition), 0.1, 1e-6);
  EXPECT_EQ(r.at(reg::kControlVelocity), 0);
}

TEST(Servo, ALimitAtWorkIsACodeNotAFault) {
  Bench bench;
  Registers r = bench.stream(with(with(kTorque, reg::kCommandTorque, 0.4), reg::kMaxTorque, 0.1), 10);
  EXPECT_EQ(r.at(reg::kMode), 10);
  EXPECT_EQ(r.at(reg::kFault), 102);
  EXPECT_NEAR(r.at(reg::kTorque), 0.1, 1e-6);
  r = bench.stream(kTorque, 2);
  EXPECT_EQ(r.at(reg::kFault), 0);
}

TEST(Servo, TheSetPointStaysWithinTheBounds) {
  SimMoteusParams params = bench_motor();
  params.servo.position_min_rev = -1;
  params.servo.position_max_rev = 1;
  Bench bench(params);
  bench.stream({{reg::kMode, 10},
                {reg::kCommandPosition, 3},
                {reg::kKpScale, 0.1},
                {reg::kVelocityLimit, -1},
                {reg::kAccelerationLimit, -1}},
               10);
  const Registers r = bench.exchange({}, {reg::kControlPosition, reg::kFault});
  EXPECT_EQ(r.at(reg::kControlPosition), 1);
  EXPECT_EQ(r.at(reg::kFault), 103);
}

// ---- control law

TEST(Servo, GainsAreInNewtonMetresPerRevolution) {
  SimMoteusParams params = bench_motor();
  params.plant.inertia_kg_m2 = 1e6;  // a wall
  Bench bench(params);
  const Writes command{{reg::kMode, 10},   {reg::kCommandPosition, 0.1}, {reg::kKpScale, 0.5},
                       {reg::kKdScale, 2}, {reg::kCommandTorque, 0.01},  {reg::kVelocityLimit, -1}};
  Registers r = bench.stream(with(command, reg::kAccelerationLimit, -1), 10);
  EXPECT_NEAR(r.at(reg::kTorque), 4 * 0.5 * 0.1 + 0.01, 1e-4);
  r = bench.stream(with(with(with(command, reg::kAccelerationLimit, -1), reg::kCommandVelocity, 1), reg::kKpScale, 0),
                   10);
  EXPECT_NEAR(r.at(reg::kTorque), 0.05 * 2 * 1 + 0.01, 1e-4);
}

TEST(Servo, AMissingPositionIsZeroAndNanIsHere) {
  SimMoteusParams params = bench_motor();
  params.plant.inertia_kg_m2 = 1e6;
  params.plant.initial_position_rad = 0.25 * kTurn + 1e-6;
  Bench bench(params);
  EXPECT_NEAR(
      bench.stream({{reg::kMode, 10}, {reg::kVelocityLimit, -1}, {reg::kAccelerationLimit, -1}}, 10).at(reg::kTorque),
      -1.0, 1e-3);
  EXPECT_NEAR(bench.stream(kTorque, 10).at(reg::kTorque), 0.05, 1e-6);
  Writes stiff = with(kTorque, reg::kKpScale, 1);
  EXPECT_NEAR(bench.stream(stiff, 10).at(reg::kTorque), 0.05, 1e-3);
}

TEST(Servo, WithoutWordOnLimitsThePlannerAcceleratesAtFifty) {
  Bench bench;
  const Writes slow{{reg::kMode, 10}, {reg::kCommandPosition, 2}, {reg::kWatchdog, kNan}};
  bench.stream(slow, 1);
  for (int i = 0; i < 400 && bench.mode() != Mode::position; ++i) bench.wait_ms(1);
  bench.wait_ms(40);
  Registers r = bench.exchange({}, {reg::kControlVelocity, reg::kTrajectoryComplete});
  EXPECT_NEAR(r.at(reg::kControlVelocity), 50 * 0.040, 0.06);
  EXPECT_EQ(r.at(reg::kTrajectoryComplete), 0);
  // 2 rev at 50 rev/s2: 2 * sqrt(2 / 50) = 0.4 s.
  for (int i = 0; i < 9; ++i) bench.wait_ms(40);
  bench.wait_ms(20);
  r = bench.exchange({}, {reg::kControlPosition, reg::kControlVelocity, reg::kTrajectoryComplete});
  EXPECT_NEAR(r.at(reg::kControlPosition), 2, 1e-4);
  EXPECT_NEAR(r.at(reg::kControlVelocity), 0, 1e-3);
  EXPECT_EQ(r.at(reg::kTrajectoryComplete), 1);
}

TEST(Servo, ThePlannerKeepsItsVelocityLimitAndNeverOvershoots) {
  Bench bench;
  bench.stream({{reg::kMode, 10}, {reg::kCommandPosition, 1}, {reg::kWatchdog, kNan}, {reg::kVelocityLimit, 2}}, 1);
  double fastest = 0;
  double farthest = 0;
  for (int i = 0; i < 800; ++i) {
    bench.wait_ms(1);
    const Registers r = bench.exchange({}, {reg::kControlPosition, reg::kControlVelocity});
    fastest = std::max(fastest, r.at(reg::kControlVelocity));
    farthest = std::max(farthest, r.at(reg::kControlPosition));
  }
  EXPECT_NEAR(fastest, 2, 1e-6);
  EXPECT_LE(farthest, 1 + 1e-5);
  EXPECT_NEAR(farthest, 1, 1e-5);
}

TEST(Servo, NegativeLimitsSwitchThePlannerOff) {
  Bench bench;
  bench.stream({{reg::kMode, 10}, {reg::kCommandPosition, 2}, {reg::kVelocityLimit, -1}, {reg::kAccelerationLimit, -1}},
               10);
  EXPECT_EQ(bench.exchange({}, {reg::kControlPosition}).at(reg::kControlPosition), 2);
}

TEST(Servo, StayWithinActsOnlyOutside) {
  SimMoteusParams params = bench_motor();
  params.plant.inertia_kg_m2 = 1e6;
  params.plant.initial_position_rad = 0.3 * kTurn;
  Bench bench(params);
  Registers r = bench.stream({{reg::kMode, 13}, {reg::kLowerBound, -0.5}, {reg::kUpperBound, 0.5}, {0x042, 0.02}}, 10);
  EXPECT_NEAR(r.at(reg::kTorque), 0.02, 1e-6);
  r = bench.stream({{reg::kMode, 13}, {reg::kLowerBound, -0.5}, {reg::kUpperBound, 0.2}}, 10);
  EXPECT_NEAR(r.at(reg::kTorque), -0.4, 1e-3);
}

TEST(Servo, TheTorqueRegisterIsZeroUnlessDriving) {
  SimMoteusParams params = bench_motor();
  params.plant.torque_lag_s = 0.01;
  Bench bench(params);
  EXPECT_GT(bench.stream(kTorque, 30).at(reg::kTorque), 0.01);
  bench.exchange(kStop);
  EXPECT_EQ(bench.exchange({}).at(reg::kTorque), 0);
  bench.exchange({{reg::kMode, 15}});
  bench.wait_ms(10);
  EXPECT_EQ(bench.exchange({}).at(reg::kTorque), 0);
}

TEST(Servo, TheBrakeSlowsDown) {
  Bench bench;
  const double before = bench.stream(with(kTorque, reg::kWatchdog, 1), 200).at(reg::kVelocity);
  const double after = bench.stream({{reg::kMode, 15}}, 100).at(reg::kVelocity);
  EXPECT_LT(std::abs(after), 0.5 * std::abs(before));
}

TEST(Servo, TheEncoderTellsWholeCounts) {
  SimMoteusParams params = bench_motor();
  params.servo.encoder_counts = 100;
  params.plant.initial_position_rad = 0.1234 * kTurn;
  Bench bench(params);
  EXPECT_FLOAT_EQ(static_cast<float>(bench.exchange({}).at(reg::kPosition)), 0.12F);
}

TEST(Servo, TheVelocityFollowsTheTrueOne) {
  Bench bench;
  const Registers r = bench.stream(kTorque, 500);
  EXPECT_NEAR(r.at(reg::kVelocity), bench.drive().servo().plant().velocity_rad_s() / kTurn, 0.1);
}

}  // namespace
}  // namespace lithe::hal::sim
