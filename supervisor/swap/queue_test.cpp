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
                  [this](const Transaction& s) { placing.push_back(s.request_id()); },
                  [this](const Transaction& s) { trying.push_back(s.request_id()); },
                  [this](const Transaction& s) { staging.push_back(s.request_id()); }, [] { return 0ULL; },
                  [this](Transaction&& s) { verdicts.push_back(s.certificate()); }},
                 100);
  }
  // All that comes before the Spine.
  static void prepare(Queue& queue, std::uint64_t id, std::int64_t now_ns) {
    queue.on_compiled(id, law("x"), "", now_ns);
    queue.on_placed(id, "slot 1", now_ns);
    queue.on_tried(id, "passed", now_ns);
  }
  static Request named(const std::string& name) { return {name, "text"}; }
  static Compiled law(const std::string& name) { return {"/x.so", "h", name, true, 1.0}; }

  std::vector<std::uint64_t> compiling, placing, trying, staging;
  std::vector<Json> verdicts;
};

TEST_F(QueueTest, DrivesOneSwapAtATimeInOrder) {
  Queue queue = make();
  EXPECT_EQ(queue.submit(named("a"), 1), 100U);
  EXPECT_EQ(queue.submit(named("b"), 2), 101U);
  queue.step(3);
  queue.step(4);
  EXPECT_EQ(compiling, (std::vector<std::uint64_t>{100}));
  prepare(queue, 100, 5);
  queue.on_staged(100, 6);
  queue.on_committed(100, 50, 1, 7);
  ASSERT_EQ(verdicts.size(), 1U);
  EXPECT_EQ(verdicts[0]["source"], "a");
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
  prepare(queue, 101, 5);
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
  prepare(queue, 101, 3);
  queue.on_committed(101, 9, 2, 3);
  queue.on_refused(101, {"x", "", ""}, 3);
  EXPECT_TRUE(staging.empty());
  EXPECT_TRUE(verdicts.empty());
}

TEST_F(QueueTest, ACommitSeenBeforeTheAcknowledgementStillCounts) {
  Queue queue = make();
  queue.submit(named("a"), 1);
  queue.step(2);
  prepare(queue, 100, 3);
  queue.on_committed(100, 9, 2, 4);
  queue.on_staged(100, 5);
  ASSERT_EQ(verdicts.size(), 1U);
  EXPECT_EQ(verdicts[0]["verdict"], "committed");
}

TEST_F(QueueTest, EachAnswerStartsTheNextStepOnce) {
  Queue queue = make();
  queue.submit(named("a"), 1);
  queue.step(2);
  for (int twice = 0; twice < 2; ++twice) {
    queue.on_compiled(100, law("a"), "13 gates", 3);
  }
  EXPECT_EQ(placing, (std::vector<std::uint64_t>{100}));
  queue.on_tried(100, "too early", 4);
  EXPECT_TRUE(staging.empty());
  for (int twice = 0; twice < 2; ++twice) {
    queue.on_placed(100, "slot 1", 4);
  }
  EXPECT_EQ(trying, (std::vector<std::uint64_t>{100}));
  for (int twice = 0; twice < 2; ++twice) {
    queue.on_tried(100, "passed", 5);
  }
  EXPECT_EQ(staging, (std::vector<std::uint64_t>{100}));
  EXPECT_EQ(queue.head()->stage(), Stage::tried);
}

TEST_F(QueueTest, WhatTheGatesTookIsToldApartFromCompiling) {
  Queue queue = make();
  queue.submit(named("a"), 1'000'000);
  queue.step(1'000'000);
  Compiled slow = law("a");
  slow.admission_ns = 3'000'000;
  queue.on_compiled(100, slow, "13 gates", 101'000'000);
  const Json split = queue.head()->certificate()["split_ms"];
  EXPECT_DOUBLE_EQ(split["compiled"], 97.0);
  EXPECT_DOUBLE_EQ(split["admitted"], 3.0);
}

TEST_F(QueueTest, ALawThatFailsItsTrialNeverComesNearTheSpine) {
  Queue queue = make();
  queue.submit(named("a"), 1);
  queue.step(2);
  queue.on_compiled(100, law("a"), "", 3);
  queue.on_placed(100, "", 4);
  queue.on_refused(100, {"trial_failed", "no", "fix"}, 5);
  EXPECT_TRUE(staging.empty());
  ASSERT_EQ(verdicts.size(), 1U);
  EXPECT_EQ(verdicts[0]["refused_after"], "placed");
}

TEST_F(QueueTest, TheTimeInTheShadowIsNotHeldAgainstIt) {
  Queue queue = make();
  Request request = named("a");
  request.terms.shadow_s = 30;
  queue.submit(request, 1);
  queue.step(1);
  prepare(queue, 100, 1);
  queue.on_shadow(100, 2);
  EXPECT_EQ(queue.head()->stage(), Stage::shadow);
  queue.step(60'000'000'000);
  EXPECT_TRUE(verdicts.empty());
  queue.step(66'000'000'000);
  ASSERT_EQ(verdicts.size(), 1U);
  EXPECT_EQ(verdicts[0]["verdict"], "not_confirmed");
}

TEST_F(QueueTest, AShadowThatAgreedIsCommitted) {
  Queue queue = make();
  queue.submit(named("a"), 1);
  queue.step(1);
  prepare(queue, 100, 1);
  queue.on_shadow(100, 2);
  queue.on_committed(100, 50, 1, 3);
  ASSERT_EQ(verdicts.size(), 1U);
  EXPECT_EQ(verdicts[0]["verdict"], "committed");
  EXPECT_TRUE(verdicts[0]["times_ns"].contains("shadow"));
}

TEST_F(QueueTest, ANewerRequestTakesThePlaceOfOneThatStillWaits) {
  Queue queue = make();
  Request request = named("mine");
  request.client = 5;
  queue.submit(request, 1);
  queue.step(1);
  queue.submit(request, 2);
  Request others = request;
  others.client = 6;
  queue.submit(others, 2);
  request.supersede = true;
  EXPECT_EQ(queue.submit(request, 3), 103U);
  ASSERT_EQ(verdicts.size(), 1U) << "not the one under way, not another client's";
  EXPECT_EQ(verdicts[0]["request_id"], 101);
  EXPECT_EQ(verdicts[0]["error"]["code"], "superseded");
  EXPECT_EQ(queue.size(), 3U);
  EXPECT_EQ(queue.head()->request_id(), 100U);
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
  prepare(queue, 100, 2);
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

TEST_F(QueueTest, WhatTheSpineHadWhenItDiedIsNotCalledRefused) {
  Queue queue = make();
  queue.submit(named("a"), 1);
  queue.submit(named("b"), 1);
  queue.step(2);
  prepare(queue, 100, 2);
  queue.refuse_all({"robot_fault", "the Spine died", "restart"}, 3);
  ASSERT_EQ(verdicts.size(), 2U);
  EXPECT_EQ(verdicts[0]["verdict"], "not_confirmed");
  EXPECT_EQ(verdicts[1]["verdict"], "refused");
}

}  // namespace
}  // namespace lithe::swap
