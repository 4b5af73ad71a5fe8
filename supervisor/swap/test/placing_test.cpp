// SPDX-License-Identifier: Apache-2.0
// Swaps on a Spine that has the code arena, against the real compile service.
#include <gtest/gtest.h>
#include <unistd.h>

#include <vector>

#include "spine/arena/arena.hpp"
#include "supervisor/swap/test/swaps_rig.hpp"

namespace lithe::control {
namespace {

class PlacingTest : public SwapsRig {
 protected:
  void describe(wire::RobotInfo& info) override {
    info.arena_base = arena::kBase;
    info.arena_slots = arena::kSlots;
    info.arena_slot_bytes = arena::kSlotBytes;
  }
  // The Loader refuses what it has been asked for; the next swap can begin.
  void refuse() {
    const std::size_t before = answers_.size();
    loader_->answer(ticket_, static_cast<std::uint32_t>(wire::StageResult::load_failed));
    tell(EventKind::law_refused, static_cast<std::uint32_t>(wire::StageResult::load_failed), 0);
    wait_for_answers(before + 1);
  }
};

class PlacingWithAnArenaTest : public PlacingTest {
 protected:
  void SetUp() override {
    auto memory = arena::make_memory();
    ASSERT_TRUE(memory) << memory.message();
    arena_.reset(*memory);
    lawd_.give(arena_.get());
    PlacingTest::SetUp();
  }
  Fd arena_;
};

TEST_F(PlacingWithAnArenaTest, LawdWritesIntoOneSlotAfterTheOther) {
  for (std::uint32_t slot = 1; slot <= 3; ++slot) {
    ask();
    if (staged_.slot == 0) GTEST_SKIP() << "this system refuses the arena";
    EXPECT_EQ(staged_.slot, slot);
    std::vector<std::byte> image(staged_.code_bytes);
    const auto at = static_cast<off_t>(arena::slot_address(slot) - arena::kBase);
    ASSERT_EQ(::pread(arena_.get(), image.data(), image.size(), at), static_cast<ssize_t>(image.size()));
    EXPECT_EQ(arena::image_hash(image), staged_.image_hash);
    EXPECT_GE(staged_.entry, arena::slot_address(slot));
    refuse();
  }
}

TEST_F(PlacingWithAnArenaTest, ASwapIsRefusedWhenNoSlotIsFreeAndDoesNotKeepOne) {
  for (std::uint32_t slot = 1; slot < arena::kSlots; ++slot) ASSERT_EQ(link_->take_slot(), slot);
  ask();
  if (staged_.slot == 0) GTEST_SKIP() << "this system refuses the arena";
  EXPECT_EQ(staged_.slot, arena::kSlots);
  tell(EventKind::law_refused, static_cast<std::uint32_t>(wire::StageResult::load_failed), 0);
  wait_for_answers(1);
  submit({"rest.cpp", kRestLaw});  // the Loader has not answered for the last slot
  wait_for_answers(2);
  EXPECT_EQ(refusal(1).code, "slots_full");
  loader_->answer(ticket_, static_cast<std::uint32_t>(wire::StageResult::load_failed));
  ask();
  EXPECT_EQ(staged_.slot, arena::kSlots);
}

TEST_F(PlacingTest, ALawdWithoutAnArenaMeansDlopenAndNoRefusal) {
  for (int i = 0; i < 2; ++i) {
    ask();
    EXPECT_EQ(staged_.slot, 0U);
    EXPECT_NE(staged_.path[0], '\0');
    refuse();
  }
  EXPECT_EQ(link_->take_slot(), 2U) << "the one that lawd could not write is given back, and no other was taken";
}

}  // namespace
}  // namespace lithe::control
