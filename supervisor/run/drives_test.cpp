// SPDX-License-Identifier: Apache-2.0
#include "supervisor/run/drives.hpp"

#include <gtest/gtest.h>

#include <initializer_list>

namespace lithe::control {
namespace {

using robot::DeviceKind;

constexpr std::uint32_t kStopped = 0, kFault = 1, kPosition = 10, kTimeout = 11, kZeroVelocity = 12;

robot::RobotConfig robot_of(std::initializer_list<DeviceKind> kinds) {
  robot::RobotConfig robot;
  for (const DeviceKind kind : kinds) {
    robot.devices.emplace_back().kind = kind;
    robot::JointConfig& joint = robot.joints.emplace_back();
    joint.device = robot.joints.size() - 1;
    joint.name = std::string(1, static_cast<char>('a' + joint.device));
  }
  return robot;
}
const robot::RobotConfig kMoteus = robot_of({DeviceKind::moteus, DeviceKind::moteus, DeviceKind::moteus});

wire::Telemetry fresh(std::initializer_list<std::uint32_t> drive_modes) {
  wire::Telemetry now{};
  for (const std::uint32_t mode : drive_modes) {
    now.joint_status[now.joint_count++] = wire::joint_status::kFresh | mode << 16;
  }
  return now;
}

TEST(Drives, TheOneFurthestFromOffSpeaksForAll) {
  EXPECT_EQ(drives_of(kMoteus, fresh({kStopped, kFault})), Drives::off);
  EXPECT_EQ(drives_of(kMoteus, fresh({kStopped, kZeroVelocity, kTimeout})), Drives::damped);
  EXPECT_EQ(drives_of(kMoteus, fresh({kStopped, kZeroVelocity, kPosition})), Drives::driven);
}

// The number of a state, and what it is: 7 is a fault with the power off, of a moteus it would be anything.
TEST(Drives, AStateOfACanopenDriveIsNotAModeOfAMoteus) {
  const robot::RobotConfig mixed = robot_of({DeviceKind::moteus, DeviceKind::cia402});
  for (const std::uint32_t state : {0U, 1U, 2U, 3U, 7U}) {
    EXPECT_EQ(drives_of(mixed, fresh({kStopped, state})), Drives::off) << state;
  }
  for (const std::uint32_t state : {5U, 6U}) {
    EXPECT_EQ(drives_of(mixed, fresh({kStopped, state})), Drives::damped) << state;
  }
  EXPECT_EQ(drives_of(mixed, fresh({kStopped, 4})), Drives::driven);
  EXPECT_EQ(drives_of(mixed, fresh({7, 7})), Drives::driven) << "of the moteus";
  EXPECT_EQ(joints_not_off(mixed, fresh({kStopped, 4})), "b");
  EXPECT_EQ(joints_not_off(mixed, fresh({kStopped, 7})), "");
}

TEST(Drives, SilenceIsNotOff) {
  wire::Telemetry now = fresh({kStopped, kStopped});
  now.joint_status[1] &= ~wire::joint_status::kFresh;
  EXPECT_EQ(drives_of(kMoteus, now), Drives::driven);
  EXPECT_EQ(drives_of(kMoteus, wire::Telemetry{}), Drives::driven);
}

TEST(Drives, NamesTheJointsThatAreNotOffAndStaysInsideTheRecord) {
  EXPECT_EQ(joints_not_off(kMoteus, fresh({kStopped, kPosition})), "b");
  wire::Telemetry hostile = fresh({kPosition});
  hostile.joint_count = 4'000'000'000U;
  EXPECT_EQ(drives_of(kMoteus, hostile), Drives::driven);
}

}  // namespace
}  // namespace lithe::control
