// SPDX-License-Identifier: Apache-2.0
#include "supervisor/swap/queue.hpp"

#include <gtest/gtest.h>

#include <vector>

namespace lithe::swap {
namespace {

class QueueTest : public testing::Test {
 protected:
  Queue make() {
    return Queue({[this](const Transaction& s) { compiling.push_back(s.request_id()); },
                  [this](const Transaction& s) { staging.push_back(s.request_id()); }, [] { return 0ULL; },
                  [this](const Transaction& s) { verdicts.push_back(s.certificate()); }},
                 100);
  }
  static Request named(const std::string& name) { return {name, "text", Json::object()}; }
  static Compiled law(const std::string& name) { return {"/x.so", "h", name, true, 1.0, Json::object()}; }

  std::vector<std::uint64_t> compiling, staging;
  std::vector<Json> verdicts;
};

TEST_F(QueueTest, DrivesOneSwapAtATimeInOrder) {
  Queue queue = make();
  EXPECT_EQ(queue.submit(named("a"), 1), 100U);
  EXPECT_EQ(queue.submit(named("b"), 2), 101U);
  queue.step(3);
  queue.step(4);
  EXPECT_EQ(compiling, (std::vector<std::uint64_t>{100}));
  queue.on_compiled(100, law("a"), 5);
  queue.on_staged(100, 6);
  queue.on_committed(100, 50, 1, 7);
  ASSERT_EQ(verdicts.size(), 1U);
  EXPECT_EQ(verdicts[0]["law"], "a");
  queue.step(8);
  EXPECT_EQ(compiling, (std::vector<std::uint64_t>{100, 101}));
  EXPECT_FALSE(queue.idle());
}

TEST_F(QueueTest, GoesOnAfterARefusal) {
  Queue queue = make();
  queue.submit(named("bad"), 1);
  queue.submit(named("good"), 1);
  queue.step(2);
  queue.on_refused(100, {"compile_failed", "no", "fix"}, 3);
  queue.step(4);
  queue.on_compiled(101, law("good"), 5);
  queue.on_committed(101, 9, 2, 6);
  ASSERT_EQ(verdicts.size(), 2U);
  EXPECT_EQ(verdicts[0]["verdict"], "refused");
  EXPECT_EQ(verdicts[1]["verdict"], "committed");
  EXPECT_TRUE(queue.idle());
}

TEST_F(QueueTest, IgnoresAnswersAboutASwapThatIsNotTheHead) {
  Queue queue = make();
  queue.submit(named("a"), 1);
  queue.submit(named("b"), 1);
  queue.step(2);
  queue.on_compiled(101, law("b"), 3);
  queue.on_committed(101, 9, 2, 3);
  queue.on_refused(101, {"x", "", ""}, 3);
  EXPECT_TRUE(staging.empty());
  EXPECT_TRUE(verdicts.empty());
}

TEST_F(QueueTest, ACommitSeenBeforeTheAcknowledgementStillCounts) {
  Queue queue = make();
  queue.submit(named("a"), 1);
  queue.step(2);
  queue.on_compiled(100, law("a"), 3);
  queue.on_committed(100, 9, 2, 4);
  queue.on_staged(100, 5);
  ASSERT_EQ(verdicts.size(), 1U);
  EXPECT_EQ(verdicts[0]["verdict"], "committed");
}

TEST_F(QueueTest, AStepThatTakesTooLongIsRefusedAndTheNextOneStarts) {
  Queue queue = make();
  queue.submit(named("slow"), 0);
  queue.submit(named("next"), 0);
  queue.step(0);
  queue.step(59'000'000'000);
  EXPECT_TRUE(verdicts.empty());
  queue.step(61'000'000'000);
  ASSERT_EQ(verdicts.size(), 1U);
  EXPECT_EQ(verdicts[0]["error"]["code"], "timeout");
  EXPECT_EQ(verdicts[0]["verdict"], "refused");
  EXPECT_EQ(compiling.size(), 2U);
}

TEST_F(QueueTest, WhatTheSpineMayStillCommitIsNotCalledRefused) {
  Queue queue = make();
  queue.submit(named("slow"), 1);
  queue.step(1);
  queue.on_compiled(100, law("slow"), 2);
  queue.step(11'000'000'000);
  ASSERT_EQ(verdicts.size(), 1U);
  EXPECT_EQ(verdicts[0]["verdict"], "not_confirmed");
  EXPECT_EQ(verdicts[0]["error"]["code"], "timeout");
  EXPECT_NE(verdicts[0]["error"]["message"].get<std::string>().find("may still take effect"), std::string::npos);
}

TEST_F(QueueTest, TakesAtMostSixtyFourWaitingRequests) {
  Queue queue = make();
  for (std::size_t i = 0; i < Queue::kMaxWaiting; ++i) {
    EXPECT_NE(queue.submit(named("a"), 1), 0U);
  }
  EXPECT_EQ(queue.submit(named("a"), 1), 0U);
}

TEST_F(QueueTest, RefusesEverythingThatWaitsWhenTheSpineIsGone) {
  Queue queue = make();
  queue.submit(named("a"), 1);
  queue.submit(named("b"), 1);
  queue.step(2);
  queue.refuse_all({"robot_fault", "the Spine died", "restart"}, 3);
  EXPECT_TRUE(queue.idle());
  EXPECT_EQ(verdicts.size(), 2U);
}

}  // namespace
}  // namespace lithe::swap
