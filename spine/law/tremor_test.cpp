// SPDX-License-Identifier: Apache-2.0
#include "spine/law/tremor.hpp"

#include <gtest/gtest.h>

#include <functional>
#include <numbers>
#include <random>

namespace lithe::law {
namespace {

using Kind = Tremor::Finding::Kind;

constexpr double kTwoPi = 2 * std::numbers::pi;

// The motion of one joint in `seconds`; each a function of the time [s]: velocity, setpoint velocity, torque.
struct Motion {
  std::function<double(double)> velocity_rad_s = [](double) { return 0.0; };
  std::function<double(double)> setpoint_rad_s = [](double) { return 0.0; };
  std::function<double(double)> torque_nm = [](double) { return 0.0; };
};

// The first result of Tremor, for a joint with 1 N m and 10 rad/s.
Tremor::Finding watch(const Motion& motion, double rate_hz = 1000, double seconds = 3) {
  Tremor tremor;
  tremor.configure(rate_hz, 0, {1.0, 10.0});
  tremor.start();
  Tick tick;
  for (int k = 0; k < seconds * rate_hz; ++k) {
    const double t_s = k / rate_hz;
    tick.velocity_rad_s[0] = motion.velocity_rad_s(t_s);
    tick.setpoint_velocity_rad_s[0] = motion.setpoint_rad_s(t_s);
    tremor.see(tick, 0, motion.torque_nm(t_s));
    if (const auto found = tremor.find(1); found.kind != Kind::none) return found;
  }
  return {};
}

std::function<double(double)> sine(double amplitude, double frequency_hz, double growth_1_s = 0) {
  return [=](double t_s) { return amplitude * std::exp(growth_1_s * t_s) * std::sin(kTwoPi * frequency_hz * t_s); };
}

TEST(Tremor, TorqueThatJumpsUpAndDownIsChatterAtEveryRate) {
  for (const double rate_hz : {100.0, 250.0, 1000.0, 10'000.0}) {
    for (const double frequency_hz : {0.5 * rate_hz, 0.3 * rate_hz}) {
      Motion motion;
      motion.torque_nm = [&](double t_s) { return std::fmod(t_s * frequency_hz + 1e-9, 1) < 0.5 ? 0.3 : -0.3; };
      const auto found = watch(motion, rate_hz);
      EXPECT_EQ(found.kind, Kind::chatter) << rate_hz << " Hz, chatter at " << frequency_hz;
      EXPECT_GE(found.frequency_hz, std::min(Tremor::kChatterHz, Tremor::kChatterOfRate * rate_hz));
      EXPECT_NEAR(found.size, 0.6, 1e-9);
    }
  }
}

TEST(Tremor, AFastMotionAStepAndNoiseAreNoChatter) {
  Motion motion;
  motion.torque_nm = sine(1, 20);
  EXPECT_EQ(watch(motion).kind, Kind::none) << "20 Hz at full torque";
  motion.torque_nm = [](double t_s) { return std::fmod(t_s, 0.1) < 0.05 ? 1.0 : -1.0; };
  EXPECT_EQ(watch(motion).kind, Kind::none) << "a step of full torque twenty times a second";
  std::mt19937 seeded(1);
  std::normal_distribution<double> noise(0, 0.02);  // a twentieth of torque_max, peak to peak
  motion.torque_nm = [&](double) { return noise(seeded); };
  EXPECT_EQ(watch(motion).kind, Kind::none);
}

TEST(Tremor, AnOscillationThatGrowsOrStaysIsFound) {
  for (const double growth : {0.0, 1.0, 5.0}) {
    for (const double frequency_hz : {3.0, 12.0, 40.0}) {
      Motion motion;
      motion.velocity_rad_s = sine(0.8, frequency_hz, growth);
      const auto found = watch(motion);
      EXPECT_EQ(found.kind, Kind::oscillation) << frequency_hz << " Hz, growth " << growth;
      EXPECT_NEAR(found.frequency_hz, frequency_hz, 0.1 * frequency_hz);
    }
  }
}

TEST(Tremor, ADecayingASmallAndASlowOscillationAreNone) {
  Motion motion;
  motion.velocity_rad_s = sine(8, 10, -0.25 * 10);  // 0.88 of the swing before
  EXPECT_EQ(watch(motion).kind, Kind::none);
  motion.velocity_rad_s = sine(0.4, 10);
  EXPECT_EQ(watch(motion).kind, Kind::none) << "swings of 0.8 rad/s; the least is 1.0";
  motion.velocity_rad_s = sine(3, 1);
  EXPECT_EQ(watch(motion).kind, Kind::none) << "motion";
}

TEST(Tremor, AMotionThatWasAskedForIsNoOscillation) {
  Motion motion;
  motion.setpoint_rad_s = sine(5, 4);
  motion.velocity_rad_s = [](double t_s) { return 4 * std::sin(kTwoPi * 4 * t_s - 0.8); };
  EXPECT_EQ(watch(motion).kind, Kind::none);
  motion.setpoint_rad_s = sine(0.3, 4);
  EXPECT_EQ(watch(motion).kind, Kind::oscillation) << "only a small part of this motion is in the setpoint";
}

// A policy of 100 Hz: the torque jumps with each step of the setpoint, and falls until the next.
TEST(Tremor, TheJumpsOfAHeldSetpointAreNoChatterOfTheLaw) {
  for (const bool told : {true, false}) {
    Tremor tremor;
    tremor.configure(1000, 0, {1.0, 10.0});
    bool found = false;
    for (int k = 0; k < 2000; ++k) {
      tremor.see(Tick{}, 0, 0.5 - 0.05 * (k % 10), {told && k % 10 == 0, 0});
      found |= tremor.find(1).kind == Kind::chatter;
    }
    EXPECT_EQ(found, !told);
  }
}

// It moves a joint to and fro at 4 Hz.
TEST(Tremor, MotionThatStepsAskForIsNoOscillation) {
  for (const double asked_rad_s : {0.0, 3.0}) {
    Tremor tremor;
    tremor.configure(1000, 0, {1.0, 10.0});
    bool found = false;
    Tick tick;
    for (int k = 0; k < 4000; ++k) {
      tick.velocity_rad_s[0] = 3 * std::sin(kTwoPi * 4 * k * 1e-3);
      tremor.see(tick, 0, 0, {false, asked_rad_s * 0.7 * std::cos(kTwoPi * 4 * k * 1e-3)});
      found |= tremor.find(1).kind == Kind::oscillation;
    }
    EXPECT_EQ(found, asked_rad_s == 0);
  }
}

TEST(Tremor, WhatShookBeforeIsNotTheNewLaws) {
  Tremor tremor;
  tremor.configure(1000, 0, {1.0, 10.0});
  Tick tick;
  int found = 0;
  for (int k = 0; k < 4000; ++k) {
    if (k == 2000) tremor.start();
    tick.velocity_rad_s[0] = 2 * std::sin(kTwoPi * 10 * k * 1e-3);
    tremor.see(tick, 0, k % 2 == 0 ? 0.5 : -0.5);
    found += k >= 2000 && tremor.find(1).kind != Kind::none;
  }
  EXPECT_EQ(found, 0);
}

}  // namespace
}  // namespace lithe::law
