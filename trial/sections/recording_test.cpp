// SPDX-License-Identifier: Apache-2.0
#include "trial/sections/recording.hpp"

#include <gtest/gtest.h>
#include <unistd.h>

#include <array>
#include <cmath>
#include <cstring>
#include <memory>
#include <span>
#include <string>

#include "spine/ipc/layout.hpp"
#include "spine/ipc/segment.hpp"

namespace lithe::trial {
namespace {

using Spine = ipc::Segment<ipc::SpineMemory>;

// A Spine's segment with `ticks` records of a robot that moves 1 mrad per tick.
class RecordingTest : public ::testing::Test {
 protected:
  void SetUp() override {
    robot_ = "trial_recording_" + std::to_string(getpid());
    auto lease = ipc::Lease::try_take(Spine::path(robot_));
    ASSERT_TRUE(lease && *lease);
    lease_ = std::move(**lease);
    auto segment = Spine::create(robot_);
    ASSERT_TRUE(segment) << segment.message();
    segment_ = std::make_unique<Spine>(std::move(*segment));
  }
  void TearDown() override {
    ipc::remove_segment(Spine::path(robot_));
    unlink((Spine::path(robot_) + ".lock").c_str());
  }
  void run(std::uint64_t from, std::uint64_t to) {
    ipc::RingWriter<wire::Telemetry, wire::spine_segment::kTelemetryDepth> writer((*segment_)->telemetry);
    auto record = std::make_unique<wire::Telemetry>();
    record->joint_count = 2;
    for (std::uint64_t tick = from; tick < to; ++tick) {
      record->tick = tick;
      record->position_rad[1] = static_cast<double>(tick) * 1e-3;
      record->setpoint_velocity_rad_s[1] = static_cast<double>(tick);
      record->command_torque_nm[1] = -static_cast<double>(tick);
      record->release_ns = static_cast<std::int64_t>(tick) * 1'000'000;
      record->sample_ns = record->release_ns - 1'000'000;
      record->brain_age_ns = -1;
      record->sensor[15] = static_cast<double>(tick);
      writer.push(*record);
    }
  }

  std::string robot_;
  ipc::Lease lease_;
  std::unique_ptr<Spine> segment_;
};

TEST_F(RecordingTest, NewestSecondsComeInOrder) {
  run(1, 6001);  // more than the ring holds
  const Recording recording(robot_, 0, 2, 1e-3, 2.0);
  ASSERT_EQ(recording.size(), 2000u);
  Tick tick;
  recording.fill(tick, 0);
  EXPECT_EQ(tick.tick, 4001u);
  recording.fill(tick, 1999);
  EXPECT_EQ(tick.tick, 6000u);
  EXPECT_DOUBLE_EQ(tick.position_rad[1], 6.0);
  EXPECT_DOUBLE_EQ(tick.setpoint_acceleration_rad_s2[1], 1000.0);
  EXPECT_DOUBLE_EQ(recording.command_torque_nm(1999, 1), -6000.0);
  EXPECT_DOUBLE_EQ(tick.sensor[15], 6000.0);
  EXPECT_DOUBLE_EQ(tick.sample_age_s, 1e-3);
  EXPECT_TRUE(std::isinf(tick.brain_age_s)) << "no Brain was ever heard";
  const auto past = recording.past(10, 2, 1e-3);
  ASSERT_EQ(past.size(), 10u);
  EXPECT_DOUBLE_EQ(past[0].position_rad[1], 6.0) << "the newest first";
  EXPECT_DOUBLE_EQ(past[9].age_s, 9e-3);
}

TEST_F(RecordingTest, AnotherRobotOrNoneGivesNoRecords) {
  run(1, 100);
  EXPECT_EQ(Recording(robot_, 0, 3, 1e-3, 2.0).size(), 0u) << "other joints";
  EXPECT_EQ(Recording(robot_, 0, 2, 1e-3, 2.0).size(), 99u);
  EXPECT_EQ(Recording("", 0, 2, 1e-3, 2.0).size(), 0u);
  EXPECT_EQ(Recording("no_such_robot", 0, 2, 1e-3, 2.0).size(), 0u);
  lease_ = ipc::Lease();
  EXPECT_EQ(Recording(robot_, 0, 2, 1e-3, 2.0).size(), 0u) << "no_torque runs it";
}

TEST_F(RecordingTest, ARobotStartedWithOtherValuesIsToldApart) {
  run(1, 100);
  wire::RobotInfo info{};
  info.values_hash = 7;
  ipc::ChannelWriter<wire::RobotInfo>((*segment_)->robot_info).write(info);
  EXPECT_FALSE(Recording(robot_, 7, 2, 1e-3, 2.0).of_another());
  EXPECT_TRUE(Recording(robot_, 8, 2, 1e-3, 2.0).of_another());
  lease_ = ipc::Lease();
  EXPECT_FALSE(Recording(robot_, 8, 2, 1e-3, 2.0).of_another()) << "none runs";
}

struct Holder {
  struct Params {};
  struct State {
    double budget_nm = 0;
    std::array<float, 2> filtered_rad{};
    double own = 3;
  };
  static void step(const Tick&, const Params&, State&, Effort&) {}
};

TEST_F(RecordingTest, ALawCarriesTheFieldsOfTheRunningOneByName) {
  run(1, 3);
  wire::LawInfo info;
  info.law_id = 7;
  info.state_field_count = 3;
  const auto field = [&](std::size_t i, const char* name, wire::StateKind kind, std::uint32_t offset) {
    std::strcpy(info.state_name.data() + 32 * i, name);
    info.state_kind[i] = static_cast<std::uint32_t>(kind);
    info.state_offset[i] = offset;
    info.state_elements[i] = 1;
  };
  field(0, "filtered_rad", wire::StateKind::f32, 8);
  field(1, "budget_nm", wire::StateKind::f64, 0);
  field(2, "own", wire::StateKind::f64, 4093);  // beyond the State: damaged
  wire::LawState state;
  state.law_id = 7;
  state.state_bytes = 16;
  const double budget_nm = 0.4;
  const float filtered_rad = 0.25;
  std::memcpy(state.bytes.data(), &budget_nm, sizeof budget_nm);
  std::memcpy(state.bytes.data() + 8, &filtered_rad, sizeof filtered_rad);
  ipc::ChannelWriter<wire::LawInfo>((*segment_)->law_info[2]).write(info);
  ipc::ChannelWriter<wire::LawState>((*segment_)->law_state).write(state);
  constexpr LitheLaw kHolder = describe<Holder>("holder");
  Holder::State carried;
  const Recording recording(robot_, 0, 2, 1e-3, 2.0);
  EXPECT_EQ(recording.carry(kHolder, std::as_writable_bytes(std::span(&carried, 1))), 2u);
  EXPECT_EQ(carried.budget_nm, 0.4);
  EXPECT_EQ(carried.filtered_rad[0], 0.25F);
  EXPECT_EQ(carried.own, 3);
  EXPECT_EQ(Recording().carry(kHolder, std::as_writable_bytes(std::span(&carried, 1))), 0u) << "no law runs";
}

TEST(RecordingWithoutASpine, PastIsARobotThatMovesSlowly) {
  const auto past = Recording().past(50, 2, 1e-3);
  ASSERT_EQ(past.size(), 50u);
  EXPECT_NE(past[0].setpoint_velocity_rad_s[1], 0);
}

}  // namespace
}  // namespace lithe::trial
