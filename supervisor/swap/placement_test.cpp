// SPDX-License-Identifier: Apache-2.0
// Against the real compile service and real segments; the Loader's answers are given by hand.
#include "supervisor/swap/placement.hpp"

#include <gtest/gtest.h>
#include <poll.h>
#include <unistd.h>

#include <optional>

#include "spine/arena/arena.hpp"
#include "spine/core/time.hpp"
#include "supervisor/link/spine/test/spine_rig.hpp"

namespace lithe::control {
namespace {

class PlacementTest : public SpineRig {
 protected:
  void SetUp() override {
    attach([](wire::RobotInfo& info) {
      info.arena_base = arena::kBase;
      info.arena_slots = arena::kSlots;
      info.arena_slot_bytes = arena::kSlotBytes;
    });
    loader_.emplace((*control_)->stage, (*spine_)->stage_ack);
    placement_.emplace(*link_, lawd_);
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
  // One compile or placement, to its end.
  template <class Start>
  auto wait_for(Start start) {
    using Got =
        std::conditional_t<std::is_invocable_v<Start, LawdLink::Callback>, Answer, std::variant<Placed, Refusal>>;
    std::optional<Got> got;
    start([&](const Got& answer) { got = answer; });
    const std::int64_t deadline_ns = monotonic_ns() + 60 * kNsPerS;
    while (!got && monotonic_ns() < deadline_ns) {
      pollfd wait{lawd_.poll_fd(), POLLIN, 0};
      ::poll(&wait, 1, 10);
      lawd_.serve(monotonic_ns());
    }
    EXPECT_TRUE(got.has_value());
    return *got;
  }

  std::optional<ipc::MailboxReceiver<wire::StageRequest, wire::control_segment::kStageDepth>> loader_;
  LawdLink lawd_{LITHE_LAWD, {}, 1};
  std::optional<Placement> placement_;
};

TEST_F(PlacementTest, SlotsOfLawsInTheSpineAreNotGivenAway) {
  for (std::uint32_t i = 0; i < 5; ++i) publish(i, 10 + i, 1 + i);
  EXPECT_EQ(placement_->free_slot(), 6U);
  publish(2, 0, 0);
  EXPECT_EQ(placement_->free_slot(), 3U) << "its law is gone";
}

TEST_F(PlacementTest, ASlotInARequestIsTakenUntilTheLoaderHasAnswered) {
  const auto ticket = link_->stage({});
  ASSERT_TRUE(ticket);
  placement_->asked(1, *ticket);
  EXPECT_EQ(placement_->free_slot(), 2U) << "a request that was given up may still be taken in";
  answer(wire::StageResult::abi_mismatch);
  EXPECT_EQ(placement_->free_slot(), 1U);
}

TEST_F(PlacementTest, ASupervisorThatAdoptsWaitsForTheAnswersToItsPredecessorsRequests) {
  for (int i = 0; i < 3; ++i) ASSERT_TRUE(link_->stage({}));
  Placement successor(*link_, lawd_);
  for (int i = 0; i < 3; ++i) {
    EXPECT_EQ(successor.free_slot(), 0U) << "nobody knows which slot request " << i << " names";
    answer(wire::StageResult::load_failed);
  }
  EXPECT_EQ(successor.free_slot(), 1U);
  ASSERT_TRUE(link_->stage({}));
  EXPECT_EQ(successor.free_slot(), 1U) << "its own requests it knows";
}

TEST_F(PlacementTest, AHostileSlotInTheSpinesMemoryHarmsNobody) {
  publish(0, 5, 0xffffffff);
  publish(1, 6, arena::kSlots + 1);
  EXPECT_EQ(placement_->free_slot(), 1U);
}

TEST_F(PlacementTest, LawdWritesIntoOneSlotAfterTheOther) {
  auto memory = arena::make_memory();
  ASSERT_TRUE(memory) << memory.message();
  const Fd arena(*memory);
  lawd_.give(arena.get());
  ASSERT_TRUE(lawd_.start(monotonic_ns()));
  const Answer compiled =
      wait_for([&](const LawdLink::Callback& then) { lawd_.compile({"rest.cpp", kRestLaw}, then, monotonic_ns()); });
  ASSERT_TRUE(std::holds_alternative<Json>(compiled));
  const std::string hash = std::get<Json>(compiled)["hash"];
  for (std::uint32_t slot = 1; slot <= 3; ++slot) {
    const auto answer =
        wait_for([&](const Placement::Callback& then) { placement_->place(hash, then, monotonic_ns()); });
    const auto* placed = std::get_if<Placed>(&answer);
    ASSERT_NE(placed, nullptr) << std::get<Refusal>(answer).message;
    if (placed->slot == 0) GTEST_SKIP() << "this system refuses the arena";
    EXPECT_EQ(placed->slot, slot);
    std::vector<std::byte> image(placed->code_bytes);
    const auto at = static_cast<off_t>(arena::slot_address(slot) - arena::kBase);
    ASSERT_EQ(::pread(arena.get(), image.data(), image.size(), at), static_cast<ssize_t>(image.size()));
    EXPECT_EQ(arena::image_hash(image), placed->image_hash);
    EXPECT_GE(placed->entry, arena::slot_address(slot));
    placement_->forget(slot);
  }
}

TEST_F(PlacementTest, ALawdWithoutAnArenaMeansDlopenAndNoRefusal) {
  ASSERT_TRUE(lawd_.start(monotonic_ns()));
  const std::string hash(64, 'a');
  for (int i = 0; i < 2; ++i) {
    const auto answer =
        wait_for([&](const Placement::Callback& then) { placement_->place(hash, then, monotonic_ns()); });
    ASSERT_TRUE(std::holds_alternative<Placed>(answer)) << std::get<Refusal>(answer).message;
    EXPECT_EQ(std::get<Placed>(answer).slot, 0U);
  }
}

}  // namespace
}  // namespace lithe::control
