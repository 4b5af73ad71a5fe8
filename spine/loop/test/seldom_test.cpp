// SPDX-License-Identifier: Apache-2.0
// Drives that hear one command in four: what must reach all of them takes as many ticks.
#include <gtest/gtest.h>

#include <atomic>
#include <string>

#include "spine/loop/test/tick_rig.hpp"

namespace lithe::loop {
namespace {

constexpr std::uint32_t kDivider = 4;

robot::RobotConfig seldom_asked() {
  robot::RobotConfig robot = *robot::parse_robot(kRobot, "probe.toml");
  for (std::uint32_t id = 2; id <= kDivider; ++id) {
    robot.devices.push_back(robot.devices[0]);
    robot.devices.back().id = id;
    robot.joints.push_back(robot.joints[0]);
    robot.joints.back().name += static_cast<char>('0' + id);
    robot.joints.back().device = id - 1;
  }
  for (robot::DeviceConfig& device : robot.devices) device.rate_divider = kDivider;
  return robot;
}

class SeldomTold : public testing::Test, protected TickBench {
 protected:
  SeldomTold() : TickBench(seldom_asked()) {
    stage(kPd);
    ticks(200);  // the drives are asked how they are set
    EXPECT_EQ(send(CommandKind::arm), CommandResult::done);
    ticks(50);
    for (std::uint32_t j = 0; j < kDivider; ++j) EXPECT_EQ(drive_mode(j), 10U) << j;
  }
  std::string last_word() {
    ipc::RingReader<wire::Event, wire::spine_segment::kEventsTickDepth> events(memory_->events_tick);
    events.rewind(1);
    wire::Event event;
    return events.next(event) ? event.text.data() : "";
  }
  std::uint32_t drive_mode(std::uint32_t j) { return handover_.latest_sample().status[j] >> 16 & 0xff; }
};

TEST_F(SeldomTold, TheLastOffReachesAllOfThem) {
  Spine last(Wiring{robot_, *memory_, *control_memory_, *brain_memory_, slot_, **sandbox_, nullptr, handover_, clock_,
                    actuators_.get()});
  const std::atomic<bool> stop{true};
  EXPECT_TRUE(last.run(stop));
  EXPECT_EQ(last_word(), "ended: every drive got the off command");
  for (std::uint32_t j = 0; j < kDivider; ++j) EXPECT_EQ(drive_mode(j), 0U) << j;
}

TEST_F(SeldomTold, ASpineWhoseTransportHangsSaysThatNotAllHaveHeard) {
  tick(false);  // nobody serves the buses any more
  const std::atomic<bool> stop{true};
  EXPECT_FALSE(spine_->run(stop));
  EXPECT_EQ(last_word(), "ended: not every drive got the off command");
}

TEST_F(SeldomTold, TheyAreNotArmedAgainBeforeAllHaveHeardThatTheyAreOff) {
  ASSERT_EQ(send(CommandKind::disarm), CommandResult::done);
  for (std::uint32_t i = 1; i < kDivider; ++i) EXPECT_EQ(send(CommandKind::arm), CommandResult::refused_not_ready) << i;
  EXPECT_EQ(send(CommandKind::arm), CommandResult::done);
}

}  // namespace
}  // namespace lithe::loop
