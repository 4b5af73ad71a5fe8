// SPDX-License-Identifier: Apache-2.0
// What the tick does when memory that must not change was found changed.
#include <string>
#include <vector>

#include "spine/loop/test/tick_rig.hpp"

namespace lithe::loop {
namespace {

using wire::EventKind;
using wire::Fault;

class MemoryTest : public TickTest {
 protected:
  MemoryTest() {
    EXPECT_TRUE(constants_.watch("the block", &block_, sizeof block_));
    Wiring wiring{robot_,  *memory_,  *control_memory_, *brain_memory_, slot_,      **sandbox_,
                  nullptr, handover_, clock_,           nullptr,        &constants_};
    spine_ = std::make_unique<Spine>(wiring);
  }
  void damage() {
    block_ = 1;
    constants_.look();
  }
  Fault fault() const { return static_cast<Fault>(record_.fault); }
  std::vector<std::string> told(EventKind kind) {
    std::vector<std::string> texts;
    ipc::RingReader<wire::Event, wire::spine_segment::kEventsTickDepth> events(memory_->events_tick);
    events.rewind();
    for (wire::Event event; events.next(event);)
      if (static_cast<EventKind>(event.kind) == kind) texts.emplace_back(event.text.data());
    return texts;
  }
  std::uint64_t block_ = 0;
  contain::Constants constants_;
};

TEST_F(MemoryTest, DamageStopsTheRobotAndSaysWhatWasDamaged) {
  arm_with(kPd);
  ASSERT_EQ(mode(), Mode::active);
  damage();
  ticks(2);
  EXPECT_EQ(mode(), Mode::safe_stop);
  EXPECT_EQ(fault(), Fault::memory_damaged);
  const std::vector<std::string> once{"memory_damaged: the block"};
  EXPECT_EQ(told(EventKind::memory_damaged), once);
  EXPECT_EQ(told(EventKind::safe_stop), once);
}

TEST_F(MemoryTest, NoVerbLeadsBackIntoMotion) {
  arm_with(kPd);
  damage();
  ticks(2);
  EXPECT_EQ(send(CommandKind::arm), CommandResult::refused_damaged);
  EXPECT_EQ(send(CommandKind::recover), CommandResult::refused_damaged);
  EXPECT_EQ(send(CommandKind::reset), CommandResult::done);
  ticks(300);
  for (const CommandKind kind : {CommandKind::arm, CommandKind::recover}) {
    EXPECT_EQ(send(kind), CommandResult::refused_damaged);
    EXPECT_EQ(mode(), Mode::disarmed);
  }
}

TEST_F(MemoryTest, ARobotThatIsOffIsNotArmedAnyMore) {
  stage(kPd);
  ticks(3);
  damage();
  ticks(1);
  EXPECT_EQ(mode(), Mode::disarmed);
  EXPECT_EQ(told(EventKind::memory_damaged).size(), 1u);
  EXPECT_EQ(send(CommandKind::arm), CommandResult::refused_damaged);
}

TEST_F(MemoryTest, TheEstopStillWins) {
  arm_with(kPd);
  damage();
  ticks(1);
  EXPECT_EQ(send(CommandKind::estop), CommandResult::done);
  EXPECT_EQ(mode(), Mode::estop);
  EXPECT_EQ(send(CommandKind::arm), CommandResult::refused_estop);
}

}  // namespace
}  // namespace lithe::loop
