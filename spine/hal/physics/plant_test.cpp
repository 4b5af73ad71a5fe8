// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/physics/plant.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

namespace lithe::hal::sim {
namespace {

constexpr double kPi = std::numbers::pi;
constexpr double kStepS = 1e-9 * static_cast<double>(Plant::kStepNs);

PlantParams pendulum() {
  PlantParams params;
  params.inertia_kg_m2 = 2.55e-3;
  params.mgl_nm = 0.165;
  return params;
}

double energy(const PlantParams& p, const Plant& plant) {
  return p.inertia_kg_m2 * plant.velocity_rad_s() * plant.velocity_rad_s() / 2 -
         p.mgl_nm * std::cos(plant.position_rad());
}

void run(Plant& plant, double seconds, double torque_nm) {
  const auto steps = static_cast<std::int64_t>(seconds / kStepS);
  for (std::int64_t i = 0; i < steps; ++i) plant.step(torque_nm);
}

// Time from rest at `amplitude` until the motion has come back, with the last step interpolated.
double measured_period_s(double amplitude_rad) {
  PlantParams params = pendulum();
  params.initial_position_rad = amplitude_rad;
  Plant plant(params);
  double zero_s[2] = {0, 0};
  int seen = 0;
  double before_rad = amplitude_rad;
  for (std::int64_t i = 1; seen < 2; ++i) {
    plant.step(0);
    if (before_rad > 0 && plant.position_rad() <= 0) {  // falling through the bottom, once a period
      const double part = before_rad / (before_rad - plant.position_rad());
      zero_s[seen++] = (static_cast<double>(i) - 1 + part) * kStepS;
    }
    before_rad = plant.position_rad();
  }
  return zero_s[1] - zero_s[0];
}

TEST(Plant, APendulumHasTheAnalyticPeriodAtEveryAmplitude) {
  const PlantParams params = pendulum();
  const double omega = std::sqrt(params.mgl_nm / params.inertia_kg_m2);
  for (const double amplitude : {0.01, 0.5, 1.5, 2.5, 3.0}) {
    const double expected = 4 * std::comp_ellint_1(std::sin(amplitude / 2)) / omega;
    EXPECT_NEAR(measured_period_s(amplitude) / expected, 1, 2e-5) << amplitude;
  }
}

TEST(Plant, WithoutFrictionEnergyNeitherGrowsNorDrains) {
  PlantParams params = pendulum();
  params.initial_position_rad = 2.0;
  Plant plant(params);
  const double start = energy(params, plant);
  double worst = 0;
  for (int i = 0; i < 20'000 * 60; ++i) {
    plant.step(0);
    worst = std::max(worst, std::abs(energy(params, plant) - start));
  }
  EXPECT_LT(worst / params.mgl_nm, 1e-3);
}

TEST(Plant, ViscousFrictionTakesTheAnalyticShareOfEnergy) {
  PlantParams params = pendulum();
  params.mgl_nm = 0;
  params.viscous_nm_s_rad = 1e-3;
  Plant plant(params);
  run(plant, 0.1, 0.1);
  const double start = plant.velocity_rad_s();
  run(plant, 1.0, 0);
  const double after = plant.velocity_rad_s();
  EXPECT_NEAR(after / start, std::exp(-params.viscous_nm_s_rad / params.inertia_kg_m2), 1e-4);
}

// Far stiffer than a step of 50 us: it slows down, and never pushes.
TEST(Plant, ViscousFrictionOfAnySizeEndsAtItsTorqueOverItself) {
  for (const double viscous : {4e-3, 1.0, 1e3, 1e6}) {
    for (const double coulomb : {0.0, 0.01}) {
      PlantParams params;
      params.inertia_kg_m2 = 1e-7;
      params.viscous_nm_s_rad = viscous;
      params.coulomb_nm = coulomb;
      Plant plant(params);
      for (int i = 0; i < 20'000; ++i) {
        plant.step(0.1);
        ASSERT_GE(plant.velocity_rad_s(), 0) << viscous;
      }
      EXPECT_NEAR(plant.velocity_rad_s() * viscous / (0.1 - coulomb), 1, 1e-9) << viscous;
      run(plant, 1, 0);
      EXPECT_NEAR(plant.velocity_rad_s(), 0, 1e-9);
    }
  }
}

TEST(Plant, CoulombFrictionStopsAFlywheelAfterTheAnalyticTimeAndHoldsItThere) {
  PlantParams params;
  params.inertia_kg_m2 = 1e-3;
  params.coulomb_nm = 0.01;
  Plant plant(params);
  run(plant, 0.5, 0.03);
  const double velocity = plant.velocity_rad_s();
  EXPECT_NEAR(velocity, 0.5 * (0.03 - 0.01) / 1e-3, 1e-6);
  const double stop_s = velocity * params.inertia_kg_m2 / params.coulomb_nm;
  run(plant, stop_s - 0.01, 0);
  EXPECT_GT(plant.velocity_rad_s(), 0);
  run(plant, 0.011, 0);
  EXPECT_EQ(plant.velocity_rad_s(), 0.0);
  const double rest = plant.position_rad();
  run(plant, 10, 0);
  EXPECT_EQ(plant.position_rad(), rest);
}

TEST(Plant, StictionHoldsUpToItsTorqueAndNotBeyond) {
  PlantParams params = pendulum();
  params.coulomb_nm = 0.0132;
  Plant plant(params);
  run(plant, 5, 0.0131);
  EXPECT_EQ(plant.position_rad(), 0.0);
  run(plant, 5, -0.0131);
  EXPECT_EQ(plant.position_rad(), 0.0);
  run(plant, 0.1, 0.0133);
  EXPECT_GT(plant.position_rad(), 0.0);
}

TEST(Plant, AnArmLeftWithinItsFrictionStaysRaised) {
  PlantParams params = pendulum();
  params.coulomb_nm = 0.0132;
  params.initial_position_rad = 0.9 * std::asin(params.coulomb_nm / params.mgl_nm);
  Plant plant(params);
  run(plant, 10, 0);
  EXPECT_EQ(plant.position_rad(), params.initial_position_rad);
}

TEST(Plant, AConstantTorqueEndsAtTheArcSine) {
  PlantParams params = pendulum();
  params.viscous_nm_s_rad = 5e-3;
  for (const double torque_nm : {0.03, 0.08, -0.12}) {
    Plant plant(params);
    run(plant, 30, torque_nm);
    EXPECT_NEAR(plant.position_rad(), std::asin(torque_nm / params.mgl_nm), 1e-6);
  }
}

TEST(Plant, WithFrictionAConstantTorqueEndsWithinTheBandOfTheArcSine) {
  PlantParams params = pendulum();
  params.viscous_nm_s_rad = 3e-5;
  params.coulomb_nm = 0.0132;
  Plant plant(params);
  run(plant, 30, 0.08);
  EXPECT_EQ(plant.velocity_rad_s(), 0.0);
  EXPECT_LE(std::abs(0.08 - params.mgl_nm * std::sin(plant.position_rad())), params.coulomb_nm);
}

TEST(Plant, TheMotorLagsByAFirstOrder) {
  PlantParams params;
  params.inertia_kg_m2 = 1e6;
  params.torque_lag_s = 1e-3;
  Plant plant(params);
  run(plant, 1e-3, 0.5);
  EXPECT_NEAR(plant.torque_nm(), 0.5 * (1 - std::exp(-1)), 1e-9);
  run(plant, 2, 0);
  EXPECT_EQ(plant.torque_nm(), 0.0) << "the tail ends, it does not become denormal";
}

TEST(Plant, TheMotorSaturates) {
  PlantParams params;
  params.torque_max_nm = 1.65;
  Plant plant(params);
  plant.step(1e9);
  EXPECT_EQ(plant.torque_nm(), 1.65);
  plant.step(-1e9);
  EXPECT_EQ(plant.torque_nm(), -1.65);
}

TEST(Plant, CoggingHoldsInItsDetentsAndRepeatsPerTurn) {
  PlantParams params;
  params.cogging_nm = 0.013;
  params.viscous_nm_s_rad = 1e-2;
  Plant one(params);
  params.initial_position_rad = 2 * kPi / params.cogging_per_rev;
  Plant next(params);
  run(one, 2, 0);
  run(next, 2, 0);
  EXPECT_NE(one.position_rad(), 0.0);
  EXPECT_NEAR(next.position_rad() - one.position_rad(), 2 * kPi / params.cogging_per_rev, 1e-9);
}

TEST(Plant, SameInputsGiveTheSameMotionToTheBitAndAnotherSeedAnotherCogging) {
  PlantParams params = pendulum();
  params.cogging_nm = 0.01;
  params.coulomb_nm = 0.002;
  params.torque_lag_s = 1e-3;
  Plant a(params);
  Plant b(params);
  params.seed = 2;
  Plant c(params);
  for (int i = 0; i < 100'000; ++i) {
    const double torque = 0.2 * std::sin(0.001 * i);
    a.step(torque);
    b.step(torque);
    c.step(torque);
    ASSERT_EQ(a.position_rad(), b.position_rad());
  }
  EXPECT_NE(a.position_rad(), c.position_rad());
}

}  // namespace
}  // namespace lithe::hal::sim
