// SPDX-License-Identifier: Apache-2.0
#include "spine/robot/limits/stopping.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>

namespace lithe::robot {
namespace {

constexpr Brakes kArm{.load_nm = 0.165,
                      .torque_max_nm = 0.6,
                      .slew_nm_s = 120,
                      .inertia_min_kg_m2 = 2.55e-3,
                      .inertia_max_kg_m2 = 2.55e-3};

// The same motion, integrated in small steps.
Stop stepped(const Brakes& brakes, double velocity_rad_s, Stretch first, Stretch next) {
  constexpr double kStepS = 2e-6;
  Stop stop{0, velocity_rad_s};
  double x = 0, v = velocity_rad_s;
  for (double t = 0;; t += kStepS) {
    const double after_s = t - first.time_s - next.time_s;
    double torque_nm = t < first.time_s ? first.torque_nm : next.torque_nm;
    if (after_s > 0) torque_nm = std::max(next.torque_nm - after_s * brakes.slew_nm_s, -brakes.torque_max_nm);
    const double net_nm = torque_nm + brakes.load_nm;
    const double a = net_nm / (net_nm > 0 ? brakes.inertia_min_kg_m2 : brakes.inertia_max_kg_m2);
    x += (v + 0.5 * a * kStepS) * kStepS;
    v += a * kStepS;
    stop.way_rad = std::max(stop.way_rad, x);
    stop.peak_rad_s = std::max(stop.peak_rad_s, v);
    if (after_s > 0 && v <= 0 && net_nm < 0) return stop;
  }
}

TEST(Stopping, TheStockArmNeedsAlmostThreeRadiansFromItsTopSpeed) {
  EXPECT_NEAR(stop_of(kArm, 30, {}, {-0.6, 0}).way_rad, 30.0 * 30.0 / (2 * 0.435 / 2.55e-3), 1e-9);
  EXPECT_NEAR(stop_of(kArm, 30, {}, {0.6, 0}).way_rad, 3.06, 0.01) << "the torque must reverse first";
}

TEST(Stopping, AtRestUnderFullBrakingItGoesNowhere) {
  const Stop stop = stop_of(kArm, 0, {-0.6, 0.005}, {-0.6, 0.001});
  EXPECT_EQ(stop.way_rad, 0);
  EXPECT_EQ(stop.peak_rad_s, 0);
}

TEST(Stopping, WhatMovesInwardsMayYetComeBack) {
  EXPECT_EQ(stop_of(kArm, -5, {0.6, 0.001}, {0.6, 0.001}).way_rad, 0);
  EXPECT_GT(stop_of(kArm, -0.5, {0.6, 0.002}, {0.6, 0.001}).way_rad, 0);
}

TEST(Stopping, TheClosedFormIsTheMotion) {
  std::mt19937_64 random(1);
  std::uniform_real_distribution<double> unit(0, 1);
  for (int i = 0; i < 300; ++i) {
    Brakes brakes;
    brakes.torque_max_nm = 0.2 + 10 * unit(random);
    brakes.load_nm = 0.8 * unit(random) * brakes.torque_max_nm;
    brakes.slew_nm_s = brakes.torque_max_nm * (20 + 300 * unit(random));
    brakes.inertia_max_kg_m2 = brakes.torque_max_nm * (0.002 + 0.01 * unit(random));
    brakes.inertia_min_kg_m2 = (0.3 + 0.7 * unit(random)) * brakes.inertia_max_kg_m2;
    const auto torque = [&] { return (2 * unit(random) - 1) * brakes.torque_max_nm; };
    const double v = 20 * unit(random) - 5;
    const Stretch first{torque(), 0.005 * unit(random)}, next{torque(), 0.002 * unit(random)};
    const Stop exact = stop_of(brakes, v, first, next), slow = stepped(brakes, v, first, next);
    ASSERT_NEAR(exact.way_rad, slow.way_rad, 2e-3 + 1e-3 * slow.way_rad) << i;
    ASSERT_NEAR(exact.peak_rad_s, slow.peak_rad_s, 0.02) << i;
  }
}

TEST(Stopping, MoreTorqueNeverStopsSooner) {
  for (double v = -3; v < 30; v += 0.7) {
    double before_rad = 0;
    for (double nm = -0.6; nm <= 0.6; nm += 0.05) {
      const double way_rad = stop_of(kArm, v, {0.1, 0.002}, {nm, 0.001}).way_rad;
      ASSERT_GE(way_rad, before_rad - 1e-12) << v << " " << nm;
      before_rad = way_rad;
    }
  }
}

}  // namespace
}  // namespace lithe::robot
