// SPDX-License-Identifier: Apache-2.0
// Against the real compile service and real segments; what the Spine says is written by hand.
#include "supervisor/swap/swaps.hpp"

#include <gtest/gtest.h>
#include <unistd.h>

#include <fstream>
#include <utility>
#include <vector>

#include "spine/core/test/full_disk_rig.hpp"
#include "supervisor/swap/test/swaps_rig.hpp"

namespace lithe::control {
namespace {

namespace fs = std::filesystem;

const Refusal kGone{"robot_fault", "the Spine is gone", "start again"};

class SwapsTest : public SwapsRig {};

TEST_F(SwapsTest, ALawThatTookTheSpineAlongIsCertifiedAsCommitted) {
  ask();
  tell(EventKind::law_staged, 7, 0);
  tell(EventKind::law_committed, 7, 500);  // no tick after it: telemetry never shows the law
  swaps_->refuse_all(kGone, monotonic_ns());
  ASSERT_EQ(answers_.size(), 1U);
  EXPECT_TRUE(std::holds_alternative<Json>(answers_[0]));
  EXPECT_EQ(certificate()["verdict"], "committed");
  EXPECT_EQ(certificate()["commit_tick"], 500);
  EXPECT_EQ(certificate()["law_id"], 7);
  EXPECT_EQ(certificate()["stage"], "retired");
  EXPECT_EQ(certificate()["reasons"]["retired"], "the Spine is gone");
  std::ifstream text(swaps_->source_of("rest"));
  EXPECT_EQ(std::string(std::istreambuf_iterator<char>(text), {}), kRestLaw);
  fs::remove(swaps_->source_of("rest"));
  EXPECT_EQ(swaps_->source_of("rest"), "") << "no file is named that is not there";
}

TEST_F(SwapsTest, TheTextOfALawThatRanStaysWhenOlderOnesGo) {
  swaps_.emplace(Swaps::Helpers{*link_, lawd_, nullptr, *commands_, log_}, CertificateFiles(dir_, 1), kFirst,
                 robot::RobotConfig{});
  ask();
  commits(7, 500);
  for (int i = 0; i < 2; ++i) submit({"bad.cpp", "this is no law"});
  wait_for_answers(3);
  EXPECT_TRUE(swaps_->source_of(7) == dir_ / "0001.cpp" && !fs::exists(dir_ / "0002.cpp"));
}

TEST_F(SwapsTest, OneWhoseCommitEventWasLostIsSeenByItsTelemetryAndTheTickIsMarkedAsAGuess) {
  ask();
  publish(800, 7);
  swaps_->refuse_all(kGone, monotonic_ns());
  EXPECT_EQ(certificate()["verdict"], "committed");
  EXPECT_EQ(certificate()["commit_tick"], 800);
  EXPECT_EQ(certificate()["commit_tick_is_estimate"], true);
}

TEST_F(SwapsTest, ALawThatIsCommittedAfterItsSwapWasGivenUpIsFollowedToItsEnd) {
  ask({{"gain", 1.5}});
  swaps_->serve(monotonic_ns() + 60 * kNsPerS);
  ASSERT_EQ(answers_.size(), 1U);
  EXPECT_EQ(refusal(0).code, "timeout");
  EXPECT_EQ(refusal(0).message,
            "the swap is not confirmed: loading 'rest.cpp' took longer than 10 s; it may still take effect");
  EXPECT_EQ(certificate()["verdict"], "not_confirmed");
  tell(EventKind::state_not_carried, 7, 500, 1, "last_rad: no finite number; starts from its default");
  tell(EventKind::law_committed, 7, 500);
  EXPECT_EQ(answers_.size(), 1U) << "one answer";
  EXPECT_EQ(certificate()["state_not_carried"]["fields"], Json({"last_rad"}));
  EXPECT_EQ(certificate()["verdict"], "committed");
  EXPECT_EQ(certificate()["commit_tick"], 500);
  EXPECT_EQ(certificate()["answered"]["verdict"], "not_confirmed");
  EXPECT_EQ(certificate()["params"]["taken"], true) << "they came with the law";
  tell(EventKind::law_confirmed, 7, 900);
  EXPECT_EQ(certificate()["verdict"], "confirmed");
}

TEST_F(SwapsTest, ALawThatTheLoaderRefusesAfterItsSwapWasGivenUpIsRefused) {
  ask();
  swaps_->serve(monotonic_ns() + 60 * kNsPerS);
  tell(EventKind::law_refused, static_cast<std::uint32_t>(wire::StageResult::dry_run_failed), 0);
  EXPECT_EQ(certificate()["verdict"], "refused");
  EXPECT_EQ(certificate()["error"]["code"], "dry_run_failed");
}

TEST_F(SwapsTest, ParametersComeWithTheirLawAndAreInForceOnItsFirstTick) {
  ask({{"gain", 1.5}});
  EXPECT_EQ(staged_.param_count, 1U) << "not a command of their own after the commit";
  EXPECT_EQ(staged_.param_index[0], 0U);
  EXPECT_EQ(staged_.param_value[0], 1.5);
  EXPECT_TRUE(certificate()["params"]["taken"].is_null());
  commits(7, 500);
  EXPECT_EQ(std::get<Json>(answers_[0])["params"]["taken"], true);
  EXPECT_EQ(certificate()["params"]["values"]["gain"], 1.5);
}

TEST_F(SwapsTest, AnswerCertificateAndStatusNameTheFieldsThatWereNotCarried) {
  ask();
  tell(EventKind::law_staged, 7, 0);
  publish(502, 7);  // the supervisor reads the events late: its answer comes with the commit
  tell(EventKind::state_not_carried, 7, 500, 2, "last_rad, gain_nm: no finite number; starts from its default");
  tell(EventKind::law_committed, 7, 500);
  ASSERT_EQ(answers_.size(), 1U);
  const Json fields = {"last_rad", "gain_nm"};
  EXPECT_EQ(std::get<Json>(answers_[0])["state_not_carried"]["fields"], fields);
  EXPECT_EQ(certificate()["state_not_carried"]["fields"], fields);
  EXPECT_EQ(certificate()["state_not_carried"]["why"], "no finite number; starts from its default");
  EXPECT_EQ(swaps_->last()["state_not_carried"], fields);
  tell(EventKind::state_not_carried, 7, 900, 1, "last_rad: no finite number; starts from its default");
  EXPECT_EQ(certificate()["state_not_carried"]["tick"], 900) << "when it came back";
}

TEST_F(SwapsTest, ALawThatHasNotMovedIsUnprovenUntilTheSpineConfirmsIt) {
  ask();
  commits(7, 500);
  tell(EventKind::law_unproven, 7, 900, 1, "of its parameters");
  EXPECT_EQ(swaps_->last()["verdict"], "committed") << "that was about parameters";
  tell(EventKind::law_unproven, 7, 900, 0, "the robot moved too little");
  EXPECT_EQ(certificate()["verdict"], "unproven");
  EXPECT_TRUE(certificate()["times_ns"].contains("staged")) << "a commit told before the acknowledgement counts";
  EXPECT_EQ(swaps_->last()["verdict"], "unproven");
  EXPECT_EQ(swaps_->last()["reason"], "the robot moved too little");
  tell(EventKind::law_confirmed, 7, 1500);
  EXPECT_EQ(certificate()["verdict"], "confirmed");
  EXPECT_FALSE(swaps_->last().contains("reason"));
}

TEST_F(SwapsTest, ALawIsMeasuredBeforeTheNextOneComesNearTheSpine) {
  ask();
  publish(499, 1);
  tell(EventKind::law_staged, 7, 0);
  commits(7, 500);
  EXPECT_FALSE(certificate().contains("measured"));
  ask();
  ASSERT_TRUE(certificate().contains("measured"));
  EXPECT_GT(certificate()["measured"]["core"]["seconds"], 0.0);
}

TEST_F(SwapsTest, WhatTheSpineHadWhenItWentIsNotCalledRefused) {
  ask();
  tell(EventKind::law_staged, 7, 0);
  swaps_->refuse_all(kGone, monotonic_ns());
  ASSERT_EQ(answers_.size(), 1U);
  EXPECT_EQ(std::get<Refusal>(answers_[0]).code, "robot_fault");
  EXPECT_EQ(certificate()["verdict"], "not_confirmed");
}

TEST_F(SwapsTest, GoesThroughAllStagesInOrderAndTellsEachTimeAndReason) {
  ask();
  EXPECT_TRUE(swaps_->waiting());
  tell(EventKind::law_staged, 7, 0);
  commits(7, 500);
  const Json told = std::get<Json>(answers_[0]);
  std::int64_t before_ns = 0;
  for (const char* stage : {"submitted", "started", "compiled", "admitted", "placed", "tried", "staged", "committed"}) {
    ASSERT_TRUE(told["times_ns"].contains(stage)) << stage;
    EXPECT_GE(told["times_ns"][stage].get<std::int64_t>(), before_ns) << stage;
    before_ns = told["times_ns"][stage];
  }
  EXPECT_EQ(told["law"], "rest");
  EXPECT_EQ(told["reasons"]["tried"], "skipped: the gates are open");
  EXPECT_TRUE(told.contains("object_sha256") && told.contains("placeable_sha256"));
  EXPECT_FALSE(swaps_->waiting());
}

TEST_F(SwapsTest, OneSwapAtATimeAndTheNextOneAfterARefusal) {
  submit({"bad.cpp", "this is no law"});
  submit({"next.cpp", "this neither"});
  EXPECT_EQ(certificate("0002.json")["times_ns"].contains("started"), false);
  wait_for_answers(2);
  EXPECT_EQ(refusal(0).code, "compile_failed");
  EXPECT_EQ(certificate("0001.json")["verdict"], "refused");
  EXPECT_EQ(certificate("0001.json")["refused_after"], "submitted");
  EXPECT_EQ(certificate("0002.json")["source"], "next.cpp");
  EXPECT_GE(certificate("0002.json")["times_ns"]["started"], certificate("0001.json")["times_ns"]["refused"]);
}

TEST_F(SwapsTest, TheTimeInTheShadowIsNotHeldAgainstIt) {
  publish(10, 3);
  ask(Json::object(), 30);
  tell(EventKind::law_staged, 7, 0);
  tell(EventKind::shadow_started, 7, 20);
  const std::int64_t now_ns = monotonic_ns();
  swaps_->serve(now_ns + 60 * kNsPerS);
  EXPECT_TRUE(answers_.empty());
  swaps_->serve(now_ns + 66 * kNsPerS);
  ASSERT_EQ(answers_.size(), 1U);
  EXPECT_EQ(certificate()["verdict"], "not_confirmed");
}

TEST_F(SwapsTest, WhoWouldWaitLongForAShadowIsToldWhoseItIsAndForHowLong) {
  publish(10, 3);
  ask(Json::object(), 30);
  SwapRequest other{"other.cpp", kRestLaw};
  submit(other);
  swaps_->serve(monotonic_ns());
  EXPECT_TRUE(answers_.empty()) << "the shadow has not begun";
  tell(EventKind::law_staged, 7, 0);
  tell(EventKind::shadow_started, 7, 20);
  const std::int64_t now_ns = monotonic_ns();
  swaps_->serve(now_ns + 10 * kNsPerS);
  ASSERT_EQ(answers_.size(), 1U);
  EXPECT_EQ(refusal(0).code, "busy");
  EXPECT_NE(refusal(0).message.find("swap 100 ('rest.cpp') runs in the shadow of the active law for 20 s more"),
            std::string::npos)
      << refusal(0).message;
  EXPECT_NE(refusal(0).next.find("in 20 s"), std::string::npos) << refusal(0).next;
  EXPECT_EQ(certificate("0002.json")["verdict"], "refused");
  submit(other);
  swaps_->serve(now_ns + 26 * kNsPerS);
  EXPECT_EQ(answers_.size(), 1U) << "4 s are not long: it waits";
  tell(EventKind::shadow_ended, 2, 30, 0.7, "compared");
  ASSERT_EQ(answers_.size(), 2U);
  EXPECT_EQ(std::get<Json>(answers_[1])["verdict"], "measured");
}

TEST_F(SwapsTest, AShadowThatAgreedIsCommittedAndOneThatDidNotIsRefused) {
  publish(10, 3);
  ask(Json::object(), 1);
  tell(EventKind::shadow_started, 7, 20);
  tell(EventKind::shadow_ended, 1, 30);
  commits(7, 31);
  EXPECT_TRUE(certificate()["times_ns"].contains("shadow"));
  EXPECT_EQ(certificate()["verdict"], "committed");
  ask(Json::object(), 1);
  tell(EventKind::law_staged, 8, 0);
  tell(EventKind::shadow_started, 8, 40);
  tell(EventKind::shadow_ended, 0, 50, 0.7, "they differ");
  ASSERT_EQ(answers_.size(), 2U);
  EXPECT_EQ(refusal(1).code, "shadow_failed");
  EXPECT_NE(refusal(1).message.find("they differ (largest difference 0.7 N m"), std::string::npos);
}

TEST_F(SwapsTest, AShadowThatIsOnlyMeasuredEndsTheSwapAndTheRunningLawGoesOn) {
  publish(10, 3);
  ask(Json::object(), 1);
  tell(EventKind::law_staged, 7, 0);
  tell(EventKind::shadow_started, 7, 20);
  tell(EventKind::shadow_ended, 2, 30, 0.7, "compared");
  ASSERT_EQ(answers_.size(), 1U);
  EXPECT_EQ(std::get<Json>(answers_[0])["verdict"], "measured");
  EXPECT_EQ(certificate()["verdict"], "measured");
  answers_.clear();
  ask();
  commits(8, 50);
  EXPECT_EQ(certificate("0002.json")["verdict"], "committed") << "and the next one comes as ever";
}

TEST_F(SwapsTest, ANewerRequestTakesThePlaceOfOneThatStillWaits) {
  SwapRequest request{"mine.cpp", kRestLaw};
  request.client = 5;
  submit(request);
  submit(request);
  SwapRequest others = request;
  others.client = 6;
  submit(others);
  request.supersede = true;
  submit(request);
  ASSERT_EQ(answers_.size(), 1U) << "not the one under way, not another client's";
  EXPECT_EQ(refusal(0).code, "superseded");
  EXPECT_EQ(certificate("0002.json")["verdict"], "refused");
  EXPECT_EQ(certificate("0001.json")["verdict"], "submitted");
}

TEST_F(SwapsTest, AStepThatTakesTooLongIsRefusedAndTheNextOneStarts) {
  submit({"slow.cpp", kRestLaw});
  submit({"next.cpp", kRestLaw});
  const std::int64_t now_ns = monotonic_ns();
  swaps_->serve(now_ns + 119 * kNsPerS);
  EXPECT_TRUE(answers_.empty());
  swaps_->serve(now_ns + 121 * kNsPerS);
  ASSERT_EQ(answers_.size(), 1U);
  EXPECT_EQ(refusal(0).code, "timeout");
  EXPECT_EQ(refusal(0).message, "compiling 'slow.cpp' took longer than 120 s");
  EXPECT_EQ(certificate("0001.json")["verdict"], "refused");
  EXPECT_EQ(certificate("0002.json")["verdict"], "submitted");
}

TEST_F(SwapsTest, ACertificateThatAFullDiskDidNotTakeIsWrittenWhenThereIsRoom) {
  ask();
  {
    const test::FullDisk full;
    tell(EventKind::law_refused, static_cast<std::uint32_t>(wire::StageResult::dry_run_failed), 0);
    swaps_->serve(monotonic_ns());
  }
  ASSERT_EQ(answers_.size(), 1U);
  EXPECT_NE(refusal(0).detail["swap"].value("record_lost", "").find("over a limit"), std::string::npos);
  swaps_->serve(monotonic_ns() + 2 * kNsPerS);
  EXPECT_EQ(certificate()["verdict"], "refused");
  EXPECT_TRUE(swaps_->certificates_error().is_null());
}

TEST_F(SwapsTest, TheLoadersRefusalCountsAlsoWithoutItsEvent) {
  ask();
  loader_->answer(ticket_, static_cast<std::uint32_t>(wire::StageResult::abi_mismatch));
  const std::int64_t now_ns = monotonic_ns();
  swaps_->serve(now_ns);
  EXPECT_TRUE(answers_.empty()) << "the event with the reason may still come";
  swaps_->serve(now_ns + 60'000'000);
  ASSERT_EQ(answers_.size(), 1U);
  EXPECT_EQ(refusal(0).code, "abi_mismatch");
  EXPECT_EQ(refusal(0).message, "the Loader refused the law: abi_mismatch");
}

TEST_F(SwapsTest, AStagedLawWhoseEventsAreAllLostIsFoundInSharedMemory) {
  ask();
  loader_->answer(ticket_, static_cast<std::uint32_t>(wire::StageResult::staged));
  const std::int64_t now_ns = monotonic_ns();
  swaps_->serve(now_ns + 60'000'000);
  publish(800, 7);
  swaps_->serve(now_ns + 90'000'000);
  EXPECT_TRUE(answers_.empty());
  swaps_->serve(now_ns + 120'000'000);
  ASSERT_EQ(answers_.size(), 1U);
  EXPECT_EQ(certificate()["verdict"], "committed");
  EXPECT_EQ(certificate()["commit_tick_is_estimate"], true);
}

TEST_F(SwapsTest, TakesAtMostSixtyFourWaitingRequestsAndRefusesAllWhenTheSpineIsGone) {
  for (std::size_t i = 0; i <= Swaps::kMaxWaiting; ++i) submit({"many.cpp", kRestLaw});
  ASSERT_EQ(answers_.size(), 1U);
  EXPECT_EQ(refusal(0).code, "busy");
  swaps_->refuse_all(kGone, monotonic_ns());
  EXPECT_EQ(answers_.size(), 1 + Swaps::kMaxWaiting);
  EXPECT_EQ(refusal(1).code, "robot_fault");
  EXPECT_EQ(certificate("0001.json")["verdict"], "refused");
}

TEST_F(SwapsTest, EventsAboutAnotherRequestDoNotMoveItAndARefusedOneTookNoParameters) {
  ask({{"gain", 1.5}});
  const std::uint64_t mine = std::exchange(request_id_, 777);
  tell(EventKind::law_committed, 7, 500);
  tell(EventKind::law_refused, static_cast<std::uint32_t>(wire::StageResult::dry_run_failed), 0);
  EXPECT_TRUE(answers_.empty());
  request_id_ = mine;
  tell(EventKind::law_refused, static_cast<std::uint32_t>(wire::StageResult::dry_run_failed), 0);
  EXPECT_EQ(refusal(0).code, "dry_run_failed");
  EXPECT_EQ(certificate()["params"]["taken"], false);
}

}  // namespace
}  // namespace lithe::control
