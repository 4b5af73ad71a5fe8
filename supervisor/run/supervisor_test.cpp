// SPDX-License-Identifier: Apache-2.0
#include "supervisor/run/supervisor.hpp"

#include <gtest/gtest.h>

#include <initializer_list>

namespace lithe::control {
namespace {

using wire::DriveState;

wire::Telemetry fresh(std::initializer_list<DriveState> states) {
  wire::Telemetry now{};
  for (const DriveState state : states) {
    now.drive_state[now.joint_count] = static_cast<std::uint32_t>(state);
    now.joint_status[now.joint_count++] = wire::joint_status::kFresh;
  }
  return now;
}

robot::RobotConfig two_joints() {
  robot::RobotConfig robot;
  robot.joints.emplace_back().name = "a";
  robot.joints.emplace_back().name = "b";
  return robot;
}

TEST(Drives, TheOneFurthestFromOffSpeaksForAll) {
  EXPECT_EQ(drives_of(fresh({DriveState::off, DriveState::fault})), Drives::off);
  EXPECT_EQ(drives_of(fresh({DriveState::off, DriveState::damped, DriveState::fault})), Drives::damped);
  EXPECT_EQ(drives_of(fresh({DriveState::off, DriveState::damped, DriveState::driven})), Drives::driven);
  EXPECT_EQ(drives_of(fresh({DriveState::off, DriveState::enabling})), Drives::driven) << "it may already turn";
}

TEST(Drives, ANumberThatIsNoStateIsNotOff) {
  wire::Telemetry hostile = fresh({DriveState::off});
  hostile.drive_state[0] = 4'000'000'000U;
  EXPECT_EQ(drives_of(hostile), Drives::driven);
}

TEST(Drives, SilenceIsNotOff) {
  wire::Telemetry now = fresh({DriveState::off, DriveState::off});
  now.joint_status[1] &= ~wire::joint_status::kFresh;
  EXPECT_EQ(drives_of(now), Drives::driven);
  EXPECT_EQ(drives_of(wire::Telemetry{}), Drives::driven);
}

TEST(Drives, NamesTheJointsThatAreNotOffAndStaysInsideTheRecord) {
  EXPECT_EQ(joints_not_off(two_joints(), fresh({DriveState::off, DriveState::driven})), "b");
  wire::Telemetry hostile = fresh({DriveState::driven});
  hostile.joint_count = 4'000'000'000U;
  EXPECT_EQ(drives_of(hostile), Drives::driven);
}

}  // namespace
}  // namespace lithe::control
