// SPDX-License-Identifier: Apache-2.0
// Whatever a Brain writes into shared memory, whole or torn, the joint stays within its limits.
#include <gtest/gtest.h>

#include <bit>
#include <cmath>
#include <random>

#include "spine/loop/test/tick_rig.hpp"

namespace lithe::loop {
namespace {

// Overwrites one word that the Spine reads with anything at all.
void damage(wire::Plan& plan, std::mt19937_64& random) {
  const std::size_t waypoint = random() % 4;
  const std::uint64_t anything = random();
  switch (random() % 5) {
    case 0:
      plan.waypoint_count = static_cast<std::uint32_t>(anything);
      break;
    case 1:
      plan.joint_count = static_cast<std::uint32_t>(anything);
      break;
    case 2:
      plan.t_ns[waypoint] = static_cast<std::int64_t>(anything);
      break;
    case 3:
      plan.position_rad[waypoint * kMaxJoints] = std::bit_cast<double>(anything);
      break;
    default:
      plan.velocity_rad_s[waypoint * kMaxJoints] = std::bit_cast<double>(anything);
  }
}

TEST_F(TickTest, DamagedPlansAndCommandsNeverLeaveTheLimits) {
  arm_with(kPd);
  std::mt19937_64 random(7);
  ipc::ChannelWriter<wire::Plan> plans(brain_memory_->plan);
  ipc::MailboxSender<wire::Command, 16> commands(brain_memory_->commands, memory_->brain_ack);
  int taken = 0, refused = 0;
  for (int i = 0; i < 20'000; ++i) {
    if (i % 5 == 0) {  // a sound plan with a few words overwritten, or none
      wire::Plan plan;
      plan.plan_id = ++plan_id_;
      plan.waypoint_count = static_cast<std::uint32_t>(1 + random() % 4);
      plan.joint_count = 1;
      for (std::uint32_t k = 0; k < plan.waypoint_count; ++k) {
        plan.t_ns[k] = now_ns_ + (k + 1) * 300 * kNsPerMs;
        plan.position_rad[k * kMaxJoints] = std::uniform_real_distribution(-2.5, 2.5)(random);
        plan.velocity_rad_s[k * kMaxJoints] = std::numeric_limits<double>::quiet_NaN();
      }
      if (i % 10 == 0) damage(plan, random);
      plans.write(plan);
    }
    if (i % 50 == 0) {
      wire::Command command;
      auto* words = reinterpret_cast<std::uint64_t*>(&command);
      for (std::size_t w = 0; w < sizeof command / 8; ++w) words[w] = random();
      command.kind = static_cast<std::uint32_t>(CommandKind::set_params);
      command.count = static_cast<std::uint32_t>(random() % 40);
      commands.send(command);
    }
    brain_memory_->header.heartbeat_ns = now_ns_;
    tick();
    taken += (record_.flags & wire::telemetry_flag::kPlanNew) != 0;
    refused += (record_.flags & wire::telemetry_flag::kPlanRefused) != 0;
    ASSERT_TRUE(std::isfinite(sent_.torque_nm[0]));
    ASSERT_LE(std::abs(sent_.torque_nm[0]), 0.6);
    ASSERT_TRUE(std::isfinite(record_.setpoint_position_rad[0]));
    ASSERT_LE(std::abs(record_.setpoint_position_rad[0]), 3.0);
    ASSERT_LE(std::abs(record_.setpoint_velocity_rad_s[0]), 30.0 * 1.001);
    ASSERT_EQ(mode(), Mode::active);
  }
  EXPECT_GT(taken, 500);
  EXPECT_GT(refused, 500);
}

TEST_F(TickTest, RandomBytesInTheBrainsMemoryNeverLeaveTheLimits) {
  arm_with(kPd);
  std::mt19937_64 random(7);
  for (int i = 0; i < 3000; ++i) {
    auto* bytes = reinterpret_cast<unsigned char*>(brain_memory_.get());
    for (int k = 0; k < 64; ++k)
      bytes[random() % (sizeof(ipc::BrainMemory) - sizeof(ipc::StickyWord))] = random() & 0xff;
    tick();
    ASSERT_TRUE(std::isfinite(sent_.torque_nm[0]));
    ASSERT_LE(std::abs(sent_.torque_nm[0]), 0.6);
    ASSERT_LE(std::abs(record_.setpoint_position_rad[0]), 3.0);
  }
}

}  // namespace
}  // namespace lithe::loop
