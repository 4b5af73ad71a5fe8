// SPDX-License-Identifier: Apache-2.0
#include "spine/guard/envelope.hpp"

#include <gtest/gtest.h>

#include <algorithm>

namespace lithe::guard {
namespace {

robot::RobotConfig arm() {
  robot::RobotConfig robot;
  robot.joints.resize(1);
  robot::JointConfig& joint = robot.joints[0];
  joint.position_min_rad = -3;
  joint.position_max_rad = 3;
  joint.velocity_max_rad_s = 30;
  joint.torque_max_nm = 0.6;
  joint.torque_slew_nm_s = 120;
  joint.load_max_nm = 0.165;
  joint.inertia_max_kg_m2 = joint.inertia_min_kg_m2 = 2.55e-3;
  return robot;
}

constexpr double kStep = 0.12;

struct Joint {
  explicit Joint(const robot::RobotConfig& robot = arm()) { envelope.configure(robot, robot.joints[0]); }
  // One tick: the wanted torque after the slew bound, the limits and the envelope.
  double ask(double wanted_nm) {
    envelope.in_flight(last_nm, last_nm);
    const double least = std::max(last_nm - kStep, -0.6), most = std::min(last_nm + kStep, 0.6);
    last_nm = envelope.bound(now, least, std::clamp(wanted_nm, least, most), most);
    return last_nm;
  }
  double settle(double wanted_nm) {
    for (int i = 0; i < 40; ++i) ask(wanted_nm);
    return last_nm;
  }
  Envelope envelope;
  Measured now;
  double last_nm = 0;
};

TEST(Envelope, FarFromTheLimitsNothingChanges) {
  Joint joint;
  EXPECT_EQ(joint.settle(0.6), 0.6);
  joint.now.velocity_rad_s = 20;
  joint.now.position_rad = -2.9;
  EXPECT_EQ(joint.settle(0.6), 0.6);
}

TEST(Envelope, WhatCouldNotStopAnyMoreIsBrakedFully) {
  Joint joint;
  joint.now = {1, 29, 0};
  EXPECT_EQ(joint.settle(0.6), -0.6);
  joint.now = {-1, -29, 0};
  EXPECT_EQ(joint.settle(-0.6), 0.6) << "in the other direction as well";
}

TEST(Envelope, InwardTorqueIsFreeAtALimit) {
  Joint joint;
  joint.now = {2.999, 0, 0};
  EXPECT_EQ(joint.settle(-0.3), -0.3);
  EXPECT_LT(joint.settle(0.6), 0.0) << "the largest load would push it beyond the limit";
}

TEST(Envelope, BeyondALimitItComesBackSlowly) {
  Joint joint;
  joint.now = {3.1, 0, 0};
  const double back_nm = joint.settle(0.6);
  EXPECT_LT(back_nm, -0.165) << "more than the largest load";
  joint.now.velocity_rad_s = -6;
  EXPECT_GT(joint.settle(0.6), back_nm) << "that is fast enough";
}

TEST(Envelope, TheSpeedThatIsAFaultIsNotReached) {
  Joint joint;
  joint.now = {-3, 35.5, 0};
  EXPECT_LT(joint.settle(0.6), 0.6);
  joint.now.velocity_rad_s = 37;
  EXPECT_EQ(joint.settle(0.6), -0.6);
}

TEST(Envelope, AnOlderSampleBrakesEarlier) {
  Joint fresh, old;
  fresh.now = {0, 22, 0};
  old.now = {0, 22, 0.02};
  EXPECT_GT(fresh.settle(0.6), old.settle(0.6));
}

// What full torque may become, `ticks` ticks after a single one with that push; `before` ticks without came first.
double after_a_push(Measured now, int ticks, double push_nm, int before = 0) {
  Joint joint;
  for (int i = 0; i < before; ++i) joint.envelope.in_flight(0, 0);
  joint.envelope.in_flight(push_nm, push_nm);
  for (int i = 0; i < ticks; ++i) joint.envelope.in_flight(0, 0);
  return joint.envelope.bound(now, -0.6, 0.6, 0.6);
}

// At 1 kHz: one tick of the pipeline, two lags of 3 ms and kMoreTicks.
constexpr int kActsForTicks = 13;

TEST(Envelope, ATorqueThatStillActedSinceTheSampleCounts) {
  for (const int age : {0, 1, 5, 11, 19}) {
    for (int before = 0; before < 8; ++before) {
      const Measured old{1.5 - 0.025 * age, 20, 1e-3 * age, static_cast<std::uint32_t>(age)};
      const int ticks = age + kActsForTicks;
      EXPECT_LT(after_a_push(old, ticks, 0.6, before), after_a_push(old, ticks, 0)) << age << ", " << before;
      EXPECT_LT(after_a_push(old, ticks, 0), 0.6) << "the limit is near";
    }
  }
}

TEST(Envelope, ATorqueThatActedBeforeTheSampleIsInIt) {
  const Measured fresh{1.5, 20, 0, 0};
  EXPECT_LT(after_a_push(fresh, 30, 0), 0.6) << "the limit is near";
  EXPECT_EQ(after_a_push(fresh, 30, 0.6), after_a_push(fresh, 30, 0));
}

TEST(Envelope, WithNothingKnownItBoundsNothing) {
  robot::RobotConfig robot = arm();
  robot.joints[0].inertia_max_kg_m2 = 0;
  Joint joint(robot);
  joint.now = {2.9, 29, 0};
  EXPECT_EQ(joint.settle(0.6), 0.6);
}

}  // namespace
}  // namespace lithe::guard
