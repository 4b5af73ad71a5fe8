// SPDX-License-Identifier: Apache-2.0
#include "supervisor/swap/transaction.hpp"

#include <gtest/gtest.h>

namespace lithe::swap {
namespace {

Transaction fresh() { return Transaction(7, {"pd.cpp", "text", Json::object()}, 1'000'000); }

Compiled pd() { return {"/x/pd.so", "abc", "pd", false, 12.5, Json::object()}; }

TEST(Transaction, WalksFromSubmittedToCommittedAndKeepsEachTime) {
  Transaction swap = fresh();
  EXPECT_TRUE(swap.mark_started(2'000'000));
  EXPECT_TRUE(swap.mark_compiled(pd(), 3'000'000));
  EXPECT_TRUE(swap.mark_staged(4'000'000));
  EXPECT_TRUE(swap.mark_committed(42, 3, 5'000'000));
  const Json record = swap.certificate();
  EXPECT_EQ(record["verdict"], "committed");
  EXPECT_EQ(record["commit_tick"], 42);
  EXPECT_EQ(record["law_id"], 3);
  EXPECT_EQ(record["hash"], "abc");
  EXPECT_DOUBLE_EQ(record["requested_to_committed_ms"].get<double>(), 4.0);
  EXPECT_EQ(record["times_ns"]["submitted"], 1'000'000);
  EXPECT_EQ(record["times_ns"]["started"], 2'000'000);
  EXPECT_EQ(record["times_ns"]["compiled"], 3'000'000);
  EXPECT_EQ(record["times_ns"]["staged"], 4'000'000);
  EXPECT_EQ(record["times_ns"]["committed"], 5'000'000);
}

TEST(Transaction, RefusesToSkipAStage) {
  Transaction swap = fresh();
  EXPECT_FALSE(swap.mark_compiled(pd(), 2));
  EXPECT_FALSE(swap.mark_staged(2));
  EXPECT_FALSE(swap.mark_committed(1, 1, 2));
  EXPECT_EQ(swap.stage(), Stage::submitted);
}

TEST(Transaction, CanBeRefusedFromAnyStageButNotAfterTheCommit) {
  Transaction early = fresh();
  EXPECT_TRUE(early.mark_refused({"compile_failed", "no", "fix"}, 2));
  EXPECT_FALSE(early.mark_started(3));
  const Json record = early.certificate();
  EXPECT_EQ(record["verdict"], "refused");
  EXPECT_EQ(record["refused_after"], "submitted");
  EXPECT_EQ(record["error"]["code"], "compile_failed");
  EXPECT_FALSE(record.contains("commit_tick"));

  Transaction late = fresh();
  late.mark_started(2);
  late.mark_compiled(pd(), 3);
  late.mark_staged(4);
  late.mark_committed(9, 1, 5);
  EXPECT_FALSE(late.mark_refused({"timeout", "", ""}, 6));
  EXPECT_EQ(late.stage(), Stage::committed);
}

TEST(Transaction, CountsOnlyTheReleasesMissedWhileItWasUnderWay) {
  Transaction swap = fresh();
  swap.mark_started(2);
  swap.mark_compiled(pd(), 3);
  swap.note_missed_before(10);
  swap.mark_staged(4);
  swap.mark_committed(9, 1, 5);
  swap.note_missed_after(12);
  EXPECT_EQ(swap.certificate()["missed_releases"], 2);
}

}  // namespace
}  // namespace lithe::swap
