// SPDX-License-Identifier: Apache-2.0
// With the segments of a Spine that is not there.
#include "supervisor/link/spine/spine_link.hpp"

#include <gtest/gtest.h>

#include <atomic>
#include <optional>
#include <thread>

#include "supervisor/link/spine/test/spine_rig.hpp"

namespace lithe::control {
namespace {

using wire::EventKind;

class SpineLinkTest : public SpineRig {
 protected:
  void SetUp() override {
    attach([](wire::RobotInfo&) {});
  }
  static wire::Event event(EventKind kind, std::int64_t t_ns) {
    wire::Event made;
    made.kind = static_cast<std::uint32_t>(kind);
    made.t_ns = t_ns;
    return made;
  }
};

TEST_F(SpineLinkTest, MergesBothRingsByTime) {
  ipc::RingWriter<wire::Event, wire::spine_segment::kEventsTickDepth> tick((*spine_)->events_tick);
  ipc::RingWriter<wire::Event, wire::spine_segment::kEventsLoaderDepth> loader((*spine_)->events_loader);
  tick.push(event(EventKind::law_committed, 2));
  loader.push(event(EventKind::law_staged, 1));
  loader.push(event(EventKind::law_retired, 3));
  const auto seen = link_->drain_events();
  ASSERT_EQ(seen.size(), 3U);
  EXPECT_EQ(seen[0].t_ns, 1);
  EXPECT_EQ(seen[1].t_ns, 2);
  EXPECT_EQ(seen[2].t_ns, 3);
  EXPECT_TRUE(link_->drain_events().empty());
}

TEST_F(SpineLinkTest, TheLastWordOfASpineIsTheLastAndNoOther) {
  ipc::RingWriter<wire::Event, wire::spine_segment::kEventsTickDepth> tick((*spine_)->events_tick);
  EXPECT_EQ(link_->confirmed_off(), std::nullopt) << "it died without a word";
  tick.push(event(EventKind::disarmed, 1));
  EXPECT_EQ(link_->confirmed_off(), std::nullopt) << "by command: it ran on";
  wire::Event last = event(EventKind::disarmed, 2);
  last.code = 2;
  tick.push(last);
  EXPECT_EQ(link_->confirmed_off(), false);
  last.code = 1;
  tick.push(last);
  EXPECT_EQ(link_->confirmed_off(), true);
  tick.push(event(EventKind::armed, 3));
  EXPECT_EQ(link_->confirmed_off(), std::nullopt);
}

// A Spine that rolls laws back and lets them go, as fast as it can, a ring's depth at most ahead of its reader.
TEST_F(SpineLinkTest, NoLawIsSeenRetiredBeforeItsRollback) {
  constexpr std::int64_t kLaws = 200'000;
  std::atomic<std::int64_t> retired{0};
  std::thread writer([&] {
    ipc::RingWriter<wire::Event, wire::spine_segment::kEventsTickDepth> tick((*spine_)->events_tick);
    ipc::RingWriter<wire::Event, wire::spine_segment::kEventsLoaderDepth> loader((*spine_)->events_loader);
    for (std::int64_t law = 1; law <= kLaws; ++law) {
      while (law - retired > 30) std::this_thread::yield();
      tick.push(event(EventKind::law_rolled_back, 2 * law));
      loader.push(event(EventKind::law_retired, 2 * law + 1));
    }
  });
  std::int64_t rolled_back = 0;
  std::int64_t too_early = 0;
  while (retired < kLaws) {
    for (const wire::Event& each : link_->drain_events()) {
      if (each.kind == static_cast<std::uint32_t>(EventKind::law_retired)) {
        too_early += rolled_back < each.t_ns - 1 ? 1 : 0;
        retired = each.t_ns / 2;
      } else {
        rolled_back = each.t_ns;
      }
    }
  }
  writer.join();
  EXPECT_EQ(too_early, 0);
  EXPECT_EQ(link_->lost_events(), 0U);
}

class ArenaSlotsTest : public SpineRig {
 protected:
  void SetUp() override {
    attach([](wire::RobotInfo& info) {
      info.arena_base = arena::kBase;
      info.arena_slots = arena::kSlots;
      info.arena_slot_bytes = arena::kSlotBytes;
    });
    loader_.emplace((*control_)->stage, (*spine_)->stage_ack);
  }

  // The Loader says that a law has its code in this slot; law_id 0: not any more.
  void publish(std::size_t place, std::uint32_t law_id, std::uint32_t slot) {
    wire::LawInfo info;
    info.law_id = law_id;
    info.slot = slot;
    ipc::ChannelWriter<wire::LawInfo>((*spine_)->law_info[place]).write(info);
  }
  void answer(wire::StageResult result) {
    wire::StageRequest request;
    std::uint64_t ticket = 0;
    ASSERT_TRUE(loader_->receive(request, ticket));
    loader_->answer(ticket, static_cast<std::uint32_t>(result));
  }
  // The slot that is free now; it stays free.
  static std::uint32_t free_slot(SpineLink& link) {
    const std::uint32_t slot = link.take_slot();
    if (slot != 0) link.give_back(slot);
    return slot;
  }

  std::optional<ipc::MailboxReceiver<wire::StageRequest, wire::control_segment::kStageDepth>> loader_;
};

TEST_F(ArenaSlotsTest, OnlyASpineWithTheSameArenaHasOne) {
  EXPECT_TRUE(link_->has_arena());
  auto info = std::make_unique<wire::RobotInfo>(link_->info());
  info->arena_slots = arena::kSlots / 2;
  ipc::ChannelWriter<wire::RobotInfo>((*spine_)->robot_info).write(*info);
  EXPECT_FALSE(SpineLink::attach(robot_)->has_arena());
}

TEST_F(ArenaSlotsTest, SlotsOfLawsInTheSpineAreNotGivenAway) {
  for (std::uint32_t i = 0; i < 5; ++i) publish(i, 10 + i, 1 + i);
  EXPECT_EQ(link_->take_slot(), 6U);
  publish(2, 0, 0);
  for (std::uint32_t slot = 7; slot <= arena::kSlots; ++slot) EXPECT_EQ(link_->take_slot(), slot);
  EXPECT_EQ(link_->take_slot(), 3U) << "its law is gone";
  EXPECT_EQ(link_->take_slot(), 0U) << "all are in use";
  link_->give_back(9);
  EXPECT_EQ(link_->take_slot(), 9U);
}

TEST_F(ArenaSlotsTest, ASlotInARequestIsTakenUntilTheLoaderHasAnswered) {
  wire::StageRequest request;
  request.slot = link_->take_slot();
  EXPECT_EQ(request.slot, 1U);
  ASSERT_TRUE(link_->stage(request));
  for (std::uint32_t slot = 2; slot <= arena::kSlots; ++slot) EXPECT_EQ(link_->take_slot(), slot);
  EXPECT_EQ(link_->take_slot(), 0U) << "a request that was given up may still be taken in";
  answer(wire::StageResult::abi_mismatch);
  EXPECT_EQ(link_->take_slot(), 1U);
}

TEST_F(ArenaSlotsTest, ASupervisorThatAdoptsWaitsForTheAnswersToItsPredecessorsRequests) {
  for (int i = 0; i < 3; ++i) ASSERT_TRUE(link_->stage({}));
  auto successor = SpineLink::attach(robot_);
  ASSERT_TRUE(successor) << successor.message();
  for (int i = 0; i < 3; ++i) {
    EXPECT_EQ(free_slot(*successor), 0U) << "nobody knows which slot request " << i << " names";
    answer(wire::StageResult::load_failed);
  }
  EXPECT_EQ(free_slot(*successor), 1U);
  ASSERT_TRUE(successor->stage({}));
  EXPECT_NE(free_slot(*successor), 0U) << "its own requests it knows";
}

TEST_F(ArenaSlotsTest, AHostileSlotInTheSpinesMemoryHarmsNobody) {
  publish(0, 5, 0xffffffff);
  publish(1, 6, arena::kSlots + 1);
  EXPECT_EQ(link_->take_slot(), 1U);
}

}  // namespace
}  // namespace lithe::control
