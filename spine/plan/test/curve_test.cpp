// SPDX-License-Identifier: Apache-2.0
// Compares the curve with its alternatives, on uneven waypoints and on plans that are replaced while they run.
#include <gtest/gtest.h>

#include <functional>
#include <numbers>
#include <random>

#include "spine/plan/knots.hpp"
#include "spine/plan/test/plan_rig.hpp"

namespace lithe::plan {
namespace {

double sine(double t_s) { return std::sin(2 * std::numbers::pi * t_s); }

struct Knot {
  double t_s, position_rad;
};

std::vector<Knot> jittered_sine(double jitter) {
  std::mt19937 random(5);
  std::uniform_real_distribution<double> offset(-jitter, jitter);
  std::vector<Knot> knots;
  for (int i = 0; i < 102; ++i) {
    const double t_s = (i + offset(random)) * 0.02;
    knots.push_back({t_s, sine(t_s)});
  }
  return knots;
}

double hermite(double u, double h, double p0, double p1, double v0, double v1) {
  const double d = (p1 - p0) / h;
  return p0 + u * (v0 + u * ((3 * d - 2 * v0 - v1) / h + u * (v0 + v1 - 2 * d) / (h * h)));
}

using Tangents = std::function<std::array<double, 2>(const std::vector<Knot>&, std::size_t)>;

// Both end slopes of segment i, as the interpolator computes them.
std::array<double, 2> non_uniform(const std::vector<Knot>& k, std::size_t i) {
  const auto at = [&](std::size_t n) {
    const double before = k[n].t_s - k[n - 1].t_s;
    const double after = k[n + 1].t_s - k[n].t_s;
    return inner_tangent(before, (k[n].position_rad - k[n - 1].position_rad) / before, after,
                         (k[n + 1].position_rad - k[n].position_rad) / after);
  };
  return {at(i), at(i + 1)};
}

// The twin: textbook Catmull-Rom, which assumes evenly spaced waypoints.
std::array<double, 2> uniform(const std::vector<Knot>& k, std::size_t i) {
  const double h = k[i + 1].t_s - k[i].t_s;
  return {(k[i + 1].position_rad - k[i - 1].position_rad) / (2 * h),
          (k[i + 2].position_rad - k[i].position_rad) / (2 * h)};
}

struct Quality {
  double rms_rad = 0;
  double velocity_jump_rad_s = 0;
};

Quality quality(const std::vector<Knot>& k, const Tangents& tangents) {
  Quality quality;
  double sum = 0;
  int count = 0;
  for (std::size_t i = 2; i + 3 < k.size(); ++i) {
    const double h = k[i + 1].t_s - k[i].t_s;
    const auto [v0, v1] = tangents(k, i);
    for (double u = 0; u < h; u += 0.001) {
      const double error = hermite(u, h, k[i].position_rad, k[i + 1].position_rad, v0, v1) - sine(k[i].t_s + u);
      sum += error * error;
      ++count;
    }
    quality.velocity_jump_rad_s = std::max(quality.velocity_jump_rad_s, std::abs(v1 - tangents(k, i + 1)[0]));
  }
  quality.rms_rad = std::sqrt(sum / count);
  return quality;
}

TEST(Curve, OnEvenWaypointsBothRulesAreTheSame) {
  EXPECT_NEAR(quality(jittered_sine(0), non_uniform).rms_rad, quality(jittered_sine(0), uniform).rms_rad, 1e-12);
  EXPECT_LT(quality(jittered_sine(0), non_uniform).rms_rad, 20e-6);
}

TEST(Curve, TimeKnotsBearTenPercentJitterAndTheUniformTwinDoesNot) {
  const Quality house = quality(jittered_sine(0.1), non_uniform);
  const Quality twin = quality(jittered_sine(0.1), uniform);
  EXPECT_LT(house.rms_rad, 25e-6);
  EXPECT_LT(house.velocity_jump_rad_s, 1e-12);
  EXPECT_GT(twin.rms_rad, 10 * house.rms_rad);
  EXPECT_GT(twin.velocity_jump_rad_s, 0.5);
}

TEST(Curve, TheInterpolatorFollowsAJitteredSineAsWellAsTheRuleAllows) {
  const std::vector<Knot> knots = jittered_sine(0.1);
  Bench bench(robot_with(1), sine(knots[10].t_s));
  std::vector<Waypoint> waypoints;
  for (std::size_t i = 10; i < 26; ++i) waypoints.push_back({knots[i].t_s * 1e3, knots[i].position_rad});
  ASSERT_EQ(bench.accept(make_plan(waypoints, true), waypoints.front().t_ms - 100), wire::PlanReject::none);
  for (double t = waypoints[2].t_ms; t < waypoints[13].t_ms; t += 0.5)
    EXPECT_NEAR(bench.at(t).position_rad[0], sine(t * 1e-3), 100e-6);
}

TEST(Curve, MonotoneNeverOvershootsAWaypointAndTheDefaultDoes) {
  std::mt19937 random(6);
  std::uniform_real_distribution<double> level(-1.5, 1.5);
  std::uniform_real_distribution<double> gap(110, 200);
  bool default_overshot = false;
  for (int round = 0; round < 200; ++round) {
    std::vector<Waypoint> waypoints{{100, 0.0}};
    while (waypoints.size() < 8) waypoints.push_back({waypoints.back().t_ms + gap(random), level(random)});
    for (const bool monotone : {true, false}) {
      robot::RobotConfig robot = robot_with(1);
      robot.joints[0].monotone = monotone;
      robot.joints[0].velocity_max_rad_s = 100;  // so that no plan is refused for its speed
      Bench bench(robot);
      ASSERT_EQ(bench.accept(make_plan(waypoints), 0), wire::PlanReject::none);
      for (std::size_t w = 0; w + 1 < waypoints.size(); ++w) {
        const auto [low, high] = std::minmax(waypoints[w].position_rad, waypoints[w + 1].position_rad);
        for (double t = waypoints[w].t_ms; t < waypoints[w + 1].t_ms; t += 5) {
          const double position = bench.at(t).position_rad[0];
          const bool overshot = position < low - 1e-9 || position > high + 1e-9;
          if (monotone) ASSERT_FALSE(overshot) << round << " " << t;
          default_overshot |= overshot;
        }
      }
    }
  }
  EXPECT_TRUE(default_overshot);
}

// A sine replanned at 50 Hz with noise on every plan. `restart` ignores the present motion: no blend.
double peak_acceleration_when_replanned(bool restart) {
  std::mt19937 random(7);
  std::normal_distribution<double> noise(0, 0.005);
  Bench bench;
  Trace trace;
  for (double t = 0; t < 2000; ++t) {
    if (static_cast<int>(t) % 20 == 0) {
      const double offset = noise(random);
      std::vector<Waypoint> waypoints;
      for (int w = -1; w < 10; ++w) {
        const double at_ms = t + w * 20 - 10;
        waypoints.push_back({at_ms, sine(at_ms * 1e-3) + offset});
      }
      if (restart) bench.interpolator.configure(robot_with(1));
      EXPECT_EQ(bench.accept(make_plan(waypoints, true), t), wire::PlanReject::none);
    }
    if (t >= 700) trace.add(bench.at(t));  // after the start from rest
    if (t < 700) (void)bench.at(t);
  }
  return trace.peak_acceleration();
}

TEST(Curve, ReplansInFlightBlendWhereAHardSwitchKnocks) {
  const double blended = peak_acceleration_when_replanned(false);
  const double hard = peak_acceleration_when_replanned(true);
  EXPECT_LT(blended, 120);  // the sine itself needs 39.5
  EXPECT_GT(hard, 5000);
}

TEST(Curve, ABlendIsOverAndExactWhenItSaysSo) {
  Bench bench;
  ASSERT_EQ(bench.accept(make_plan({{-20, 0.01, 0}, {1000, 0.01, 0}}), 0), wire::PlanReject::none);
  EXPECT_NEAR(bench.at(0).position_rad[0], 0.0, 1e-15);
  EXPECT_GT(std::abs(bench.at(50).position_rad[0] - 0.01), 1e-6);  // sqrt(6 e / a) = 55 ms
  EXPECT_EQ(bench.at(56).position_rad[0], 0.01);
}

}  // namespace
}  // namespace lithe::plan
