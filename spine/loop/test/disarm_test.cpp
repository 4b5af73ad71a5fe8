// SPDX-License-Identifier: Apache-2.0
// What takes a robot's torque off brakes it first.
#include <cmath>

#include "spine/loop/test/tick_rig.hpp"

namespace lithe::loop {
namespace {

using DisarmTest = TickTest;

// `push` drives the joint: whatever takes its torque off brakes it first, and says so. Its plain twin does not.
TEST_F(DisarmTest, AMovingJointIsBrakedBeforeItsDriveIsOff) {
  for (const bool at_once : {false, true}) {
    arm_with(kPush);
    for (int i = 0; i < 1000 && std::abs(record_.velocity_rad_s[0]) < 5; ++i) tick();
    ASSERT_GE(std::abs(record_.velocity_rad_s[0]), 5);
    const double from_rad = record_.position_rad[0];
    wire::Command disarm;
    disarm.kind = static_cast<std::uint32_t>(CommandKind::disarm);
    disarm.count = at_once ? 1 : 0;
    ASSERT_EQ(send(disarm), CommandResult::done);
    EXPECT_EQ(mode(), at_once ? Mode::disarmed : Mode::safe_stop);
    if (at_once) continue;
    EXPECT_EQ(send(CommandKind::arm), CommandResult::refused_mode) << "not in the middle of it";
    int braking = 0;
    for (; braking < 3000 && mode() == Mode::safe_stop; ++braking) tick();
    EXPECT_EQ(mode(), Mode::disarmed);
    EXPECT_LT(std::abs(record_.velocity_rad_s[0]), 0.05 + 0.6 / 2.5e-3 / 1000)
        << "one tick at most since it was at rest";
    // Twice the way that it takes with deceleration_rad_s2 from its speed then.
    EXPECT_LT(std::abs(record_.position_rad[0] - from_rad), 2 * 5.5 * 5.5 / (2 * 20.0));
    ticks(5);
    EXPECT_EQ(sent_.action[0], hal::DriveAction::off);
  }
}

TEST_F(DisarmTest, AResetBrakesTooAndTheDriveOfAJointAtRestIsOffAtOnce) {
  arm_with(kPush);
  for (int i = 0; i < 1000 && std::abs(record_.velocity_rad_s[0]) < 5; ++i) tick();
  for (int i = 0; i < 6; ++i) tick(false);  // the bus is late
  serve();
  ticks(3);
  ASSERT_EQ(mode(), Mode::safe_stop);
  ASSERT_GE(std::abs(record_.velocity_rad_s[0]), 0.05);
  ASSERT_EQ(send(CommandKind::reset), CommandResult::done);
  EXPECT_EQ(mode(), Mode::safe_stop);
  for (int i = 0; i < 3000 && mode() == Mode::safe_stop; ++i) tick();
  EXPECT_EQ(mode(), Mode::disarmed);
  EXPECT_EQ(static_cast<wire::Fault>(record_.fault), wire::Fault::none);
  arm_with(kPd);
  ticks(300);
  ASSERT_LT(std::abs(record_.velocity_rad_s[0]), 0.05);
  EXPECT_EQ(send(CommandKind::disarm), CommandResult::done);
  EXPECT_EQ(mode(), Mode::disarmed);
}

}  // namespace
}  // namespace lithe::loop
