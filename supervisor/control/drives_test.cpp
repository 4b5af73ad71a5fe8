// SPDX-License-Identifier: Apache-2.0
#include "supervisor/control/drives.hpp"

#include <gtest/gtest.h>

#include <initializer_list>

namespace lithe::control {
namespace {

constexpr std::uint32_t kStopped = 0, kFault = 1, kPosition = 10, kTimeout = 11, kZeroVelocity = 12;

wire::Telemetry fresh(std::initializer_list<std::uint32_t> drive_modes) {
  wire::Telemetry now{};
  for (const std::uint32_t mode : drive_modes) {
    now.joint_status[now.joint_count++] = wire::joint_status::kFresh | mode << 16;
  }
  return now;
}

TEST(Drives, TheOneFurthestFromOffSpeaksForAll) {
  EXPECT_EQ(drives_of(fresh({kStopped, kFault})), Drives::off);
  EXPECT_EQ(drives_of(fresh({kStopped, kZeroVelocity, kTimeout})), Drives::damped);
  EXPECT_EQ(drives_of(fresh({kStopped, kZeroVelocity, kPosition})), Drives::driven);
}

TEST(Drives, SilenceIsNotOff) {
  wire::Telemetry now = fresh({kStopped, kStopped});
  now.joint_status[1] &= ~wire::joint_status::kFresh;
  EXPECT_EQ(drives_of(now), Drives::driven);
  EXPECT_EQ(drives_of(wire::Telemetry{}), Drives::driven);
}

TEST(Drives, NamesTheJointsThatAreNotOffAndStaysInsideTheRecord) {
  wire::RobotInfo info{};
  info.joint_name[0] = 'a';
  info.joint_name[32] = 'b';
  EXPECT_EQ(joints_not_off(info, fresh({kStopped, kPosition})), "b");
  wire::Telemetry hostile = fresh({kPosition});
  hostile.joint_count = 4'000'000'000U;
  EXPECT_EQ(drives_of(hostile), Drives::driven);
}

}  // namespace
}  // namespace lithe::control
