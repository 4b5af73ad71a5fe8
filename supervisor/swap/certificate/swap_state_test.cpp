// SPDX-License-Identifier: Apache-2.0
#include "supervisor/swap/certificate/swap_state.hpp"

#include <gtest/gtest.h>

namespace lithe::control {
namespace {

SwapState fresh() { return SwapState(7, {"pd.cpp", "text"}, 1'000'000); }

Compiled pd() { return {"/x/pd.so", "abc", "pd", false, 12.5}; }

constexpr Stage kWay[] = {Stage::submitted, Stage::compiled,  Stage::admitted,    Stage::placed,
                          Stage::tried,     Stage::staged,    Stage::shadow,      Stage::committed,
                          Stage::unproven,  Stage::confirmed, Stage::rolled_back, Stage::retired};
constexpr Stage kAll[] = {Stage::submitted,   Stage::compiled, Stage::admitted,  Stage::placed,   Stage::tried,
                          Stage::staged,      Stage::shadow,   Stage::committed, Stage::unproven, Stage::confirmed,
                          Stage::rolled_back, Stage::retired,  Stage::refused,   Stage::measured};

bool go(SwapState& swap, Stage stage, std::int64_t now_ns) {
  switch (stage) {
    case Stage::compiled:
      return swap.mark_compiled(pd(), now_ns);
    case Stage::committed:
      return swap.mark_committed(42, 3, now_ns);
    case Stage::refused:
      return swap.mark_refused({"x", "", ""}, now_ns);
    default:
      return swap.mark(stage, "why", now_ns);
  }
}

// The state of a swap that has come to this stage the long way.
SwapState at(Stage stage) {
  SwapState swap = fresh();
  swap.mark_started(2'000'000);
  std::int64_t now_ns = 2'000'000;
  for (const Stage each : kWay) {
    if (each != Stage::submitted) EXPECT_TRUE(go(swap, each, now_ns += 1'000'000)) << to_string(each);
    if (each == stage) break;
  }
  return swap;
}

TEST(SwapState, WalksTheWholeWayAndKeepsEachTimeAndReason) {
  const SwapState swap = at(Stage::retired);
  const Json record = swap.certificate();
  EXPECT_EQ(record["verdict"], "rolled_back") << "what became of it, not that it is gone";
  EXPECT_EQ(record["stage"], "retired");
  EXPECT_EQ(record["commit_tick"], 42);
  EXPECT_EQ(record["law_id"], 3);
  EXPECT_EQ(record["hash"], "abc");
  EXPECT_DOUBLE_EQ(record["requested_to_committed_ms"].get<double>(), 8.0);
  EXPECT_EQ(record["times_ns"]["started"], 2'000'000);
  for (std::size_t i = 0; i < std::size(kWay); ++i) {
    const std::int64_t expected_ns = i == 0 ? 1'000'000 : 2'000'000 + static_cast<std::int64_t>(i) * 1'000'000;
    EXPECT_EQ(record["times_ns"][to_string(kWay[i])], expected_ns) << to_string(kWay[i]);
  }
  EXPECT_EQ(record["reasons"]["rolled_back"], "why");
}

TEST(SwapState, TheSplitAddsUpToTheWhole) {
  const Json record = at(Stage::committed).certificate();
  double sum_ms = 0;
  for (const auto& [stage, part_ms] : record["split_ms"].items()) sum_ms += part_ms.get<double>();
  EXPECT_DOUBLE_EQ(sum_ms, record["requested_to_committed_ms"].get<double>());
  EXPECT_TRUE(record["split_ms"].contains("tried"));
  EXPECT_DOUBLE_EQ(record["load_ms"].get<double>(),
                   record["split_ms"]["placed"].get<double>() + record["split_ms"]["staged"].get<double>());
}

TEST(SwapState, TellsTheParametersItWasAskedFor) {
  EXPECT_FALSE(at(Stage::committed).certificate().contains("params"));
  SwapState swap(7, {"pd.cpp", "text", {{"kp", 2.0}}}, 1);
  EXPECT_EQ(swap.certificate()["params"]["values"]["kp"], 2.0);
  EXPECT_TRUE(swap.certificate()["params"]["taken"].is_null()) << "not known yet";
  swap.mark_refused({"busy", "", ""}, 2);
  EXPECT_EQ(swap.certificate()["params"]["taken"], false) << "they come with their law, or not at all";
}

TEST(SwapState, IsUnprovenUntilItIsConfirmed) {
  SwapState swap = at(Stage::unproven);
  EXPECT_STREQ(swap.verdict(), "unproven");
  EXPECT_EQ(swap.certificate()["reasons"]["unproven"], "why");
  EXPECT_TRUE(go(swap, Stage::confirmed, 99'000'000));
  EXPECT_STREQ(swap.verdict(), "confirmed");
  EXPECT_FALSE(swap.certificate()["reasons"].contains("unproven")) << "a reason that no longer holds";
  EXPECT_EQ(swap.certificate()["times_ns"]["unproven"], at(Stage::unproven).certificate()["times_ns"]["unproven"]);
}

TEST(SwapState, OneThatIsOnlyMeasuredIsNeitherRefusedNorCommitted) {
  SwapState swap = at(Stage::shadow);
  EXPECT_TRUE(swap.mark(Stage::measured, "as long as asked", 99'000'000));
  EXPECT_TRUE(swap.finished() && !swap.refusal());
  const Json record = swap.certificate();
  EXPECT_EQ(record["verdict"], "measured");
  EXPECT_FALSE(record.contains("commit_tick") || record.contains("error"));
}

TEST(SwapTerms, PromoteIsTrueOrFalseAndFalseSaysForHowLong) {
  const auto read = [](const Json& args) { return read_terms(args, {}, 1000); };
  EXPECT_TRUE(std::get<SwapTerms>(read({{"shadow_s", 2}})).promote);
  EXPECT_FALSE(std::get<SwapTerms>(read({{"shadow_s", 2}, {"promote", false}})).promote);
  EXPECT_EQ(std::get<Refusal>(read({{"promote", false}})).code, "usage");
  EXPECT_EQ(std::get<Refusal>(read({{"shadow_s", 2}, {"promote", 0}})).code, "usage");
}

TEST(SwapState, EveryStageFollowsOnlyWhatItMay) {
  const std::pair<Stage, Stage> allowed[] = {
      {Stage::submitted, Stage::compiled},    {Stage::compiled, Stage::admitted},
      {Stage::admitted, Stage::placed},       {Stage::placed, Stage::tried},
      {Stage::tried, Stage::staged},          {Stage::staged, Stage::shadow},
      {Stage::staged, Stage::committed},      {Stage::shadow, Stage::committed},
      {Stage::shadow, Stage::measured},       {Stage::committed, Stage::confirmed},
      {Stage::committed, Stage::rolled_back}, {Stage::committed, Stage::unproven},
      {Stage::unproven, Stage::confirmed},    {Stage::unproven, Stage::rolled_back},
      {Stage::unproven, Stage::retired},      {Stage::committed, Stage::retired},
      {Stage::confirmed, Stage::rolled_back}, {Stage::confirmed, Stage::retired},
      {Stage::rolled_back, Stage::retired},   {Stage::rolled_back, Stage::unproven},
      {Stage::rolled_back, Stage::confirmed}};
  for (const Stage from : kWay) {
    for (const Stage to : kAll) {
      SwapState swap = at(from);
      const bool expected = (to == Stage::refused && from < Stage::committed) ||
                            std::find(std::begin(allowed), std::end(allowed), std::pair(from, to)) != std::end(allowed);
      EXPECT_EQ(go(swap, to, 99'000'000), expected) << to_string(from) << " -> " << to_string(to);
      EXPECT_EQ(swap.stage(), expected ? to : from);
    }
  }
}

TEST(SwapState, NothingButARefusalBeforeItsTurnHasCome) {
  for (const Stage to : kAll) {
    SwapState swap = fresh();
    EXPECT_EQ(go(swap, to, 2), to == Stage::refused) << to_string(to);
  }
}

TEST(SwapState, ARefusedOneSaysAfterWhatAndWhy) {
  SwapState swap = at(Stage::placed);
  ASSERT_TRUE(swap.mark_refused({"trial_failed", "no", "fix"}, 9'000'000));
  const Json record = swap.certificate();
  EXPECT_EQ(record["verdict"], "refused");
  EXPECT_EQ(record["refused_after"], "placed");
  EXPECT_EQ(record["error"]["code"], "trial_failed");
  EXPECT_EQ(record["reasons"]["refused"], "trial_failed");
  EXPECT_EQ(record["times_ns"]["refused"], 9'000'000);
  EXPECT_FALSE(record.contains("commit_tick"));
}

TEST(SwapState, GivingUpIsARefusalOnlyWhileTheSpineHasNotBeenAsked) {
  for (const char* why : {"timeout", "robot_fault", "stopping"}) {
    SwapState early = at(Stage::placed);
    EXPECT_TRUE(early.mark_given_up({why, "", ""}, 9'000'000));
    EXPECT_STREQ(early.verdict(), "refused");
    EXPECT_FALSE(go(early, Stage::committed, 9'500'000)) << "nobody was asked";
    for (const Stage with_the_spine : {Stage::tried, Stage::staged, Stage::shadow}) {
      SwapState late = at(with_the_spine);
      EXPECT_TRUE(late.mark_given_up({why, "", ""}, 9'000'000));
      EXPECT_STREQ(late.verdict(), "not_confirmed") << why;
      EXPECT_TRUE(late.certificate()["times_ns"].contains("not_confirmed"));
      EXPECT_FALSE(late.mark_given_up({why, "", ""}, 9'500'000)) << "once is enough";
    }
  }
  SwapState refused = at(Stage::staged);
  refused.mark_refused({"shadow_failed", "", ""}, 9'000'000);
  EXPECT_STREQ(refused.verdict(), "refused") << "the Spine itself said so";
}

TEST(SwapState, WhatTheSpineTellsLateIsWhatCounts) {
  for (const Stage with_the_spine : {Stage::tried, Stage::shadow}) {
    SwapState swap = at(with_the_spine);
    swap.mark_given_up({"timeout", "", ""}, 90'000'000);
    ASSERT_TRUE(go(swap, Stage::committed, 80'000'000)) << "when it was, not when it was read";
    const Json record = swap.certificate();
    EXPECT_EQ(record["verdict"], "committed");
    EXPECT_EQ(record["times_ns"]["committed"], 80'000'000);
    EXPECT_EQ(record["answered"]["verdict"], "not_confirmed");
    EXPECT_EQ(record["answered"]["t_ns"], 90'000'000);
    EXPECT_EQ(record["answered"]["error"]["code"], "timeout");
    EXPECT_FALSE(record.contains("error"));
    EXPECT_TRUE(go(swap, Stage::rolled_back, 99'000'000));
  }
  SwapState refused = at(Stage::staged);
  refused.mark_given_up({"timeout", "", ""}, 90'000'000);
  ASSERT_TRUE(refused.mark_refused({"dry_run_failed", "", ""}, 95'000'000));
  EXPECT_STREQ(refused.verdict(), "refused");
  EXPECT_FALSE(go(refused, Stage::committed, 99'000'000));
}

TEST(SwapState, ATimeBeforeItsPredecessorCountsAsEqualToIt) {
  SwapState swap = at(Stage::tried);
  swap.mark(Stage::staged, "", 5);
  EXPECT_EQ(swap.certificate()["split_ms"]["staged"], 0.0);
}

TEST(SwapState, CountsOnlyTheReleasesMissedWhileItWasUnderWay) {
  SwapState swap = at(Stage::tried);
  swap.note_missed_before(10);
  swap.mark(Stage::staged, "", 9'000'000);
  swap.mark_committed(9, 1, 9'000'000);
  swap.note_missed_after(12);
  EXPECT_EQ(swap.certificate()["missed_releases"], 2);
}

TEST(SwapState, NamesItsSourceByContentAndKeepsWhatStagesFound) {
  SwapState swap = at(Stage::compiled);
  swap.note("trial", {{"ok", true}});
  const Json record = swap.certificate();
  EXPECT_EQ(record["source_sha256"], "982d9e3eb996f559e633f4d194def3761d909f5a3b647d1a851fead67c32c9d1");
  EXPECT_EQ(record["trial"]["ok"], true);
  EXPECT_TRUE(record["terms"].contains("blend_s"));
}

robot::RobotConfig arm() {
  robot::RobotConfig robot;
  robot.joints.resize(2);
  robot.joints[0].torque_max_nm = 2.0;
  robot.joints[1].torque_max_nm = 0.5;
  return robot;
}

const SwapTerms kTerms = terms_of(arm(), 1000.0);

TEST(SwapTerms, AreTheRobotsUnlessTheRequestSaysOtherwise) {
  EXPECT_DOUBLE_EQ(kTerms.budget_us, 300.0);
  EXPECT_DOUBLE_EQ(kTerms.shadow_tolerance_nm, 0.05);
  const auto read = read_terms({{"blend_s", 0.1}, {"probation_s", 0}, {"source", "x"}}, kTerms, 1000.0);
  ASSERT_TRUE(std::holds_alternative<SwapTerms>(read));
  EXPECT_DOUBLE_EQ(std::get<SwapTerms>(read).blend_s, 0.1);
  EXPECT_DOUBLE_EQ(std::get<SwapTerms>(read).probation_s, 0.0);
  EXPECT_DOUBLE_EQ(std::get<SwapTerms>(read).error_ratio, kTerms.error_ratio);
}

TEST(SwapTerms, GoToTheSpineInTicksAndAShortTimeIsStillOne) {
  SwapTerms terms = kTerms;
  terms.shadow_s = 2.0;
  terms.blend_s = 0.0001;
  wire::StageRequest request;
  put_terms(terms, 1000.0, request);
  EXPECT_EQ(request.shadow_ticks, 2000U);
  EXPECT_EQ(request.blend_ticks, 1U);
  EXPECT_EQ(request.probation_ticks, 1000U);
  EXPECT_EQ(request.budget_ns, 300'000U);
  EXPECT_DOUBLE_EQ(request.probation_error_ratio, 3.0);
}

TEST(SwapTerms, WhatDoesNotFitIsRefusedByName) {
  const Json wrong[] = {{{"blend_s", -1}},      {{"blend_s", "20ms"}}, {{"probation_s", 61}},
                        {{"error_ratio", 0.5}}, {{"shadow_s", 1e9}},   {{"shadow_tolerance_nm", 0}},
                        {{"budget_us", 1001}},  {{"budget_us", 0}},    {{"box_ms", 1}}};
  for (const Json& args : wrong) {
    const auto read = read_terms(args, kTerms, 1000.0);
    ASSERT_TRUE(std::holds_alternative<Refusal>(read)) << args.dump();
    EXPECT_EQ(std::get<Refusal>(read).code, "usage");
    EXPECT_NE(std::get<Refusal>(read).message.find(args.begin().key()), std::string::npos);
  }
}

TEST(SwapTerms, AnAgentKeepsToTheFencesOfTheRobotFile) {
  for (const Json& looser : {Json{{"probation_s", 0}}, Json{{"probation_s", 0.99}}, Json{{"error_ratio", 0}},
                             Json{{"error_ratio", 3.01}}, Json{{"budget_us", 301}}}) {
    EXPECT_TRUE(std::holds_alternative<SwapTerms>(read_terms(looser, kTerms, 1000.0))) << "a person may";
    Json args = looser;
    args["fenced"] = true;
    const auto read = read_terms(args, kTerms, 1000.0);
    ASSERT_TRUE(std::holds_alternative<Refusal>(read)) << args.dump();
    EXPECT_EQ(std::get<Refusal>(read).code, "no_permission");
    EXPECT_TRUE(std::get<Refusal>(read).message.starts_with(looser.begin().key())) << std::get<Refusal>(read).message;
  }
  SwapTerms open = kTerms;
  open.error_ratio = open.probation_s = 0;  // the file judges nothing
  const Json stricter = {{"fenced", true}, {"probation_s", 1}, {"error_ratio", 2}, {"budget_us", 300}};
  for (const SwapTerms& robots : {kTerms, open})
    EXPECT_TRUE(std::holds_alternative<SwapTerms>(read_terms(stricter, robots, 1000.0)));
  EXPECT_TRUE(std::holds_alternative<SwapTerms>(read_terms({{"fenced", true}, {"error_ratio", 0}}, open, 1000.0)));
}

TEST(SwapTerms, ZeroSwitchesOffWhatHasALeastValue) {
  const auto read = read_terms({{"error_ratio", 0}}, kTerms, 1000.0);
  ASSERT_TRUE(std::holds_alternative<SwapTerms>(read));
  EXPECT_DOUBLE_EQ(std::get<SwapTerms>(read).error_ratio, 0.0);
}

}  // namespace
}  // namespace lithe::control
