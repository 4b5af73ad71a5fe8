// SPDX-License-Identifier: Apache-2.0
// What comes broken is counted where a user can see it.
#include <gtest/gtest.h>

#include "spine/loop/tick_bench.hpp"

namespace lithe::loop {
namespace {

TEST_F(TickTest, ASoundBrainAndSupervisorLeaveHealthAtZero) {
  arm_with(kPd);
  for (int i = 0; i < 50; ++i) {
    publish(0.1);
    tick();
  }
  EXPECT_EQ(memory_->health.plans_torn, 0U);
  EXPECT_EQ(memory_->health.brain_violations, 0U);
  EXPECT_EQ(memory_->health.control_violations, 0U);
}

TEST_F(TickTest, APlanThatIsNeverWholeIsCountedEachTimeItIsGivenUp) {
  arm_with(kPd);
  brain_memory_->plan.slots[1].record.sequence = 2 * 5 + 1;  // its writer died in the middle of plan 5 ...
  brain_memory_->plan.latest = 5;                            // ... which it had announced: no writer of ours does
  ticks(3);
  EXPECT_EQ(memory_->health.plans_torn, 3U);
  EXPECT_EQ(mode(), Mode::active);
}

TEST_F(TickTest, ImpossibleHeadsAndBrokenLettersAreCountedBySender) {
  arm_with(kPd);
  brain_memory_->commands.head += 1000;
  tick();
  EXPECT_EQ(memory_->health.brain_violations, 1U);
  ++brain_memory_->commands.head;  // a letter that was announced and never written
  tick();
  EXPECT_EQ(memory_->health.brain_violations, 2U);
  EXPECT_EQ(memory_->health.control_violations, 0U);
  control_memory_->commands.head += 17;
  tick();
  EXPECT_EQ(memory_->health.control_violations, 1U);
  EXPECT_EQ(memory_->health.brain_violations, 2U);
  EXPECT_EQ(mode(), Mode::active);
}

}  // namespace
}  // namespace lithe::loop
