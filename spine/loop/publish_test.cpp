// SPDX-License-Identifier: Apache-2.0
// The State of the running law, as a Brain sees it.
#include "spine/loop/publish.hpp"

#include <gtest/gtest.h>

#include <cstring>

#include "spine/loop/test/tick_rig.hpp"

namespace lithe::loop {
namespace {

struct Counts {
  struct Params {};
  struct State {
    std::uint32_t steps = 0;
    std::array<double, 3> held{0.5, 1.5, 2.5};
  };
  static void step(const Tick&, const Params&, State& s, Effort&) { ++s.steps; }
};
struct Remembers {
  struct Params {};
  struct State {
    std::array<double, kMaxStateBytes / 8> word{};
  };
  static void step(const Tick& t, const Params&, State& s, Effort&) { s.word.fill(static_cast<double>(t.tick)); }
};
struct Forgets {
  struct Params {};
  struct State {};
  static void step(const Tick&, const Params&, State&, Effort&) {}
};
constexpr LitheLaw kCounts = describe<Counts>("counts");
constexpr LitheLaw kRemembers = describe<Remembers>("remembers");
constexpr LitheLaw kForgets = describe<Forgets>("forgets");

class LawStateTest : public TickTest {
 protected:
  // The newest one that is published; law_id 0: none.
  wire::LawState published() {
    wire::LawState state;
    ipc::ChannelReader<wire::LawState>(memory_->law_state).read(state);
    return state;
  }
  const law::Resident& running() { return *slot_.active(); }
};

TEST_F(LawStateTest, IsThatOfTheRunningLawAtTheEndOfATick) {
  arm_with(kCounts);
  ticks(20);
  while (record_.tick % 10 != 0) tick();
  const wire::LawState state = published();
  EXPECT_EQ(state.law_id, running().law_id);
  EXPECT_EQ(state.tick, record_.tick);
  ASSERT_EQ(state.state_bytes, sizeof(Counts::State));
  EXPECT_EQ(std::memcmp(state.bytes.data(), running().state.data(), state.state_bytes), 0);
  Counts::State counts;
  std::memcpy(&counts, state.bytes.data(), sizeof counts);
  EXPECT_GT(counts.steps, 20u);
  EXPECT_EQ(counts.held[2], 2.5);
}

TEST_F(LawStateTest, IsPublishedAHundredTimesASecondAndNoOftener) {
  arm_with(kCounts);
  const std::uint64_t before = memory_->law_state.latest;
  ticks(1000);
  EXPECT_EQ(memory_->law_state.latest - before, 100u);
}

TEST_F(LawStateTest, OfTheLargestLawIsWhole) {
  arm_with(kRemembers);
  ticks(20);
  while (record_.tick % 10 != 0) tick();
  const wire::LawState state = published();
  ASSERT_EQ(state.state_bytes, kMaxStateBytes);
  EXPECT_EQ(std::memcmp(state.bytes.data(), running().state.data(), kMaxStateBytes), 0);
  double last = 0;
  std::memcpy(&last, state.bytes.data() + kMaxStateBytes - 8, 8);
  EXPECT_EQ(last, static_cast<double>(record_.tick));
}

TEST_F(LawStateTest, IsTheNewLawsAfterASwap) {
  arm_with(kCounts);
  ticks(20);
  stage(kForgets);
  ticks(20);
  EXPECT_EQ(published().law_id, running().law_id);
  EXPECT_EQ(published().state_bytes, 0u);
}

TEST_F(LawStateTest, OfNoLawIsNotPublished) {
  ticks(20);
  EXPECT_EQ(memory_->law_state.latest, 0u);
}

}  // namespace
}  // namespace lithe::loop
