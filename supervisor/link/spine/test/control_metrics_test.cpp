// SPDX-License-Identifier: Apache-2.0
#include "supervisor/link/spine/metrics.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <memory>

#include "supervisor/link/spine/test/spine_rig.hpp"

namespace lithe::control {
namespace {

// A Spine of 1 kHz with two joints, of which the second one rests: law 1 to tick 500, then law 2.
class ControlMetrics : public SpineRig {
 protected:
  void SetUp() override {
    attach([](wire::RobotInfo& info) {
      info.rate_hz = 1000;
      info.joint_count = 2;
      info.torque_max_nm[0] = info.torque_max_nm[1] = 2;
    });
  }
  // The setpoint moves at 3 rad/s; the sample is one tick old. Law 1 lags by 0.1 rad, law 2 by nothing.
  void run(std::uint64_t ticks) {
    ipc::RingWriter<wire::Telemetry, wire::spine_segment::kTelemetryDepth> ring((*spine_)->telemetry);
    auto record = std::make_unique<wire::Telemetry>();
    for (std::uint64_t tick = 1; tick <= ticks; ++tick) {
      const bool first = tick <= 500;
      const double t_s = static_cast<double>(tick) * 1e-3;
      record->tick = tick;
      record->joint_count = 2;
      record->law_id = first ? 1 : 2;
      record->mode = static_cast<std::uint32_t>(tick > 100 && tick <= 150 ? wire::Mode::hold : wire::Mode::active);
      record->release_ns = static_cast<std::int64_t>(tick) * 1'000'000;
      record->release_jitter_ns = 20'000;
      record->sample_ns = record->release_ns - 980'000;
      record->missed_releases = tick > 700 ? 3 : 0;
      record->flags = tick > 900 ? wire::telemetry_flag::kTorqueClamped : 0;
      record->setpoint_position_rad[0] = 3 * t_s;
      record->setpoint_velocity_rad_s[0] = 3;
      record->position_rad[0] = 3 * (t_s - 1e-3) - (first ? 0.1 : 0);
      record->command_torque_nm[0] = tick > 900 ? -2 : 1;
      record->law_torque_nm[0] = (tick / 5 % 2 == 0 ? 1 : -1) * (first ? 0.1 : 0.5);  // 100 Hz
      record->command_torque_nm[1] = record->law_torque_nm[1] = 0.3;
      ring.push(*record);
    }
  }
};

TEST_F(ControlMetrics, ComparesSampleAndSetpointOfTheSameInstant) {
  run(1000);
  const LawControl before = measure_control(*link_, 1, 0, 500), after = measure_control(*link_, 2, 500, 1000);
  EXPECT_EQ(before.ticks, 450u) << "ticks in hold do not count";
  EXPECT_EQ(after.ticks, 500u);
  ASSERT_EQ(after.joints.size(), 2u);
  EXPECT_NEAR(before.joints[0].rms_error_rad, 0.1, 1e-9);
  EXPECT_NEAR(after.joints[0].rms_error_rad, 0, 1e-9) << "not 3 mrad, which the sample's age alone makes";
  EXPECT_NEAR(after.joints[0].max_error_rad, 0, 1e-9);
}

TEST_F(ControlMetrics, CountsWhatTheGuardAndTheMachineDid) {
  run(1000);
  const LawControl after = measure_control(*link_, 2, 500, 1000);
  EXPECT_EQ(after.missed, 3u);
  EXPECT_DOUBLE_EQ(after.clamped, 0.2);
  EXPECT_DOUBLE_EQ(after.joints[0].clamped, 0.2);
  EXPECT_EQ(after.joints[1].clamped, 0) << "the guard clamped another joint";
  EXPECT_DOUBLE_EQ(after.joints[0].at_limit, 0.2);
  EXPECT_DOUBLE_EQ(after.joints[0].max_torque_nm, 2);
  EXPECT_NEAR(after.joints[0].rms_torque_nm, std::sqrt(0.8 + 0.2 * 4), 1e-9);
  EXPECT_NEAR(after.joints[0].moved_rad, 3 * 0.499, 1e-6);
  EXPECT_NEAR(after.joints[0].chatter_hz, 100, 2);
  EXPECT_EQ(measure_control(*link_, 1, 0, 500).joints[0].chatter_hz, 0) << "0.2 of 2 N m up and down is no chatter";
}

TEST_F(ControlMetrics, WhatHasLeftTheRingIsNotCounted) {
  EXPECT_EQ(measure_control(*link_, 1, 0, 500).ticks, 0u);
  run(9000);
  EXPECT_EQ(measure_control(*link_, 1, 0, 500).ticks, 0u);
  EXPECT_EQ(law_in(*link_, 500), 0u);
  EXPECT_EQ(law_in(*link_, 8999), 2u);
}

}  // namespace
}  // namespace lithe::control
