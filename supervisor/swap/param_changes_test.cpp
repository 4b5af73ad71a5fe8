// SPDX-License-Identifier: Apache-2.0
// Against the real trial, with an object that the real compile service has made; what the Spine says is written by
// hand.
#include "supervisor/swap/param_changes.hpp"

#include <gtest/gtest.h>
#include <poll.h>
#include <unistd.h>

#include <algorithm>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "spine/core/test/emulation_rig.hpp"
#include "spine/core/time.hpp"
#include "spine/ipc/segment.hpp"
#include "supervisor/link/services/services.hpp"
#include "supervisor/link/spine/test/spine_rig.hpp"

namespace lithe::control {
namespace {

using wire::EventKind;

constexpr const char* kLaw =
    "#include <lithe/law.hpp>\n"
    "struct Spring {\n"
    "  struct Params { lithe::Param kp{2.0, -5.0, 500.0}; lithe::Param kd{0.05, 0.0, 1.0}; };\n"
    "  struct State {};\n"
    "  static void step(const lithe::Tick& t, const Params& p, State&, lithe::Effort& e) {\n"
    "    e.torque_nm[0] = p.kp * (t.setpoint_position_rad[0] - t.position_rad[0]) - p.kd * t.velocity_rad_s[0];\n"
    "  }\n"
    "};\n"
    "LITHE_LAW(Spring, \"spring\");\n";
constexpr std::uint64_t kRequest = 70;

class ParamChangesTest : public SpineRig {
 protected:
  void SetUp() override {
#if defined(__SANITIZE_ADDRESS__)
    GTEST_SKIP() << "a sanitizer cannot live in the sandbox";
#endif
    if (const std::string why = test::why_no_trial(); !why.empty()) GTEST_SKIP() << why;
    attach([](wire::RobotInfo& info) {
      info.rate_hz = 1000;
      info.joint_count = 1;
      info.joint_name = {'e', 'l', 'b', 'o', 'w'};
    });
    tick_.emplace((*control_)->commands, (*spine_)->control_ack);
    commands_.emplace(*link_, 1);
    laws_.emplace(*link_);
    ASSERT_TRUE(lawd_.start(monotonic_ns()) && trial_.start(monotonic_ns()));
    make(&trial_);
    compile();
    publish(7);
  }
  void make(TrialLink* trial) {
    changes_.emplace(ParamChanges::Helpers{*link_, trial, *commands_, log_, *laws_}, SwapTerms{},
                     [this](std::uint64_t request_id, const Json& all) {
                       EXPECT_EQ(request_id, kRequest);
                       kept_ = all;
                     });
  }
  void wait_for(const std::function<bool()>& done) {
    const std::int64_t deadline_ns = monotonic_ns() + 60 * kNsPerS;
    bool over = done();
    while (!over && monotonic_ns() < deadline_ns) {
      pollfd wait[2] = {{lawd_.poll_fd(), POLLIN, 0}, {trial_.poll_fd(), POLLIN, 0}};
      ::poll(wait, 2, 10);
      lawd_.serve(monotonic_ns());
      trial_.serve(monotonic_ns());
      over = done();
    }
    EXPECT_TRUE(over);
  }
  // The law, and how it tried as it is compiled.
  void compile() {
    std::optional<Answer> got, tried;
    lawd_.compile({"spring.cpp", kLaw}, [&](const Answer& answer) { got = answer; }, monotonic_ns());
    wait_for([&] { return got.has_value(); });
    ASSERT_TRUE(std::holds_alternative<Json>(*got)) << std::get<Refusal>(*got).message;
    TrialRequest request;
    request.object = std::get<Json>(*got).value("object", "");
    request.budget_ns = 300'000;
    request.box_ms = 2000;
    trial_.attempt(request, [&](const Answer& answer) { tried = answer; }, monotonic_ns());
    wait_for([&] { return tried.has_value(); });
    ASSERT_TRUE(std::holds_alternative<Json>(*tried)) << std::get<Refusal>(*tried).message;
    laws_->passed(kRequest, request, {{"kp", 2.0}, {"kd", 0.05}}, std::get<Json>(*tried));
  }
  // What the Spine shows: this law runs, with these values.
  void publish(std::uint32_t law_id, double kp = 2.0, double kd = 0.05) {
    auto record = std::make_unique<wire::Telemetry>();
    record->tick = ++now_tick_;
    record->law_id = law_id;
    ipc::RingWriter<wire::Telemetry, wire::spine_segment::kTelemetryDepth>((*spine_)->telemetry).push(*record);
    wire::LawInfo law;
    law.law_id = law_id;
    law.request_id = kRequest;
    law.name = {'s', 'p', 'r', 'i', 'n', 'g'};
    law.param_count = 2;
    law.param_name[0] = law.param_name[32] = 'k';
    law.param_name[1] = 'p';
    law.param_name[33] = 'd';
    law.param_min[0] = -5;
    law.param_max[0] = 500;
    law.param_max[1] = 1;
    ipc::ChannelWriter<wire::LawInfo>((*spine_)->law_info[0]).write(law);
    wire::Params live;
    live.law_id = law_id;
    live.count = 2;
    live.value[0] = kp;
    live.value[1] = kd;
    ipc::ChannelWriter<wire::Params>((*spine_)->params).write(live);
  }
  void set(const Json& values, bool dry_run = false) {
    changes_->set(values, dry_run, [this](const Answer& answer) { answers_.push_back(answer); }, monotonic_ns());
  }
  bool reaches_the_spine() {
    std::uint64_t ticket = 0;
    if (!tick_->receive(command_, ticket)) return false;
    ticket_ = ticket;
    return true;
  }
  void spine_takes_it(double kp, double kd = 0.05) {
    tick_->answer(ticket_, static_cast<std::uint32_t>(wire::CommandResult::done));
    tell(EventKind::params_applied, command_.request_id);
    commands_->serve(monotonic_ns());
    publish(7, kp, kd);
    publish(7, kp, kd);
    commands_->serve(monotonic_ns());
  }
  void tell(EventKind kind, std::uint64_t request_id, double value = 0, const std::string& text = "") {
    wire::Event event;
    event.kind = static_cast<std::uint32_t>(kind);
    event.request_id = request_id;
    event.code = 7;
    event.value = value;
    std::copy_n(text.begin(), std::min(text.size(), event.text.size() - 1), event.text.begin());
    changes_->on_event(event);
  }
  const Refusal& refusal(std::size_t i) { return std::get<Refusal>(answers_.at(i)); }

  std::optional<ipc::MailboxReceiver<wire::Command, wire::control_segment::kCommandsDepth>> tick_;
  LawdLink lawd_{LITHE_LAWD, {}, 1};
  TrialLink trial_{LITHE_TRIAL, LITHE_ROBOT, {}};
  std::optional<Commands> commands_;
  EventLog log_;
  std::optional<TriedLaws> laws_;
  std::uint64_t now_tick_ = 0, ticket_ = 0;
  wire::Command command_;
  Json kept_;
  std::vector<Answer> answers_;
  std::optional<ParamChanges> changes_;
};

TEST_F(ParamChangesTest, OneThatIsUnderWayWhenTheRobotEndsIsNotConfirmed) {
  set({{"kp", 3.0}});
  wait_for([&] { return reaches_the_spine(); });
  EXPECT_EQ(kept_[0]["verdict"], "sent");
  changes_->refuse_all({"robot_fault", "the Spine is gone", "start again"});
  EXPECT_EQ(kept_[0]["verdict"], "not_confirmed");
  EXPECT_EQ(refusal(0).code, "robot_fault");
}

TEST_F(ParamChangesTest, ValuesThatFailTheTrialNeverReachTheSpine) {
  set({{"kp", -3.0}});
  wait_for([&] { return !answers_.empty(); });
  EXPECT_FALSE(reaches_the_spine());
  EXPECT_EQ(refusal(0).code, "trial_failed");
  EXPECT_EQ(refusal(0).message.find("kp = -3 (now 2): loop: "), 0U) << refusal(0).message;
  EXPECT_NE(refusal(0).message.find("joint shoulder"), std::string::npos) << "of the robot of the trial";
  EXPECT_NE(refusal(0).next.find("nothing was changed"), std::string::npos);
  ASSERT_EQ(kept_.size(), 1U);
  EXPECT_EQ(kept_[0]["verdict"], "refused");
  EXPECT_EQ(kept_[0]["before"]["kp"], 2.0);
  EXPECT_EQ(changes_->last()["law"], "spring");
}

TEST_F(ParamChangesTest, ADryRunIsTriedAndKeptNowhere) {
  set({{"kp", 3.0}}, true);
  set({{"kp", -3.0}}, true);
  wait_for([&] { return answers_.size() == 2; });
  EXPECT_GT(std::get<Json>(answers_[0])["trial_ms"], 0.0);
  EXPECT_EQ(refusal(1).code, "trial_failed");
  EXPECT_FALSE(reaches_the_spine());
  EXPECT_TRUE(kept_.empty());
}

TEST_F(ParamChangesTest, ValuesThatPassAreSetAndFollowedUntilTheyAreProven) {
  set({{"kp", 3.0}});
  wait_for([&] { return reaches_the_spine(); });
  EXPECT_EQ(command_.law_id, 7U) << "of no other law";
  EXPECT_EQ(command_.value[0], 3.0);
  EXPECT_TRUE(answers_.empty());
  spine_takes_it(3.0);
  ASSERT_EQ(answers_.size(), 1U);
  EXPECT_GT(std::get<Json>(answers_[0])["trial_ms"].get<double>(), 0);
  EXPECT_EQ(kept_[0]["verdict"], "taken");
  tell(EventKind::law_unproven, command_.request_id, 1, "moved too little");
  EXPECT_EQ(kept_[0]["verdict"], "unproven");
  EXPECT_EQ(changes_->last()["reason"], "moved too little");
  tell(EventKind::law_unproven, command_.request_id, 1, "guard_busy: joint elbow");
  EXPECT_TRUE(kept_[0].contains("next"));
  tell(EventKind::params_confirmed, command_.request_id);
  EXPECT_EQ(kept_[0]["verdict"], "confirmed");
  EXPECT_FALSE(kept_[0].contains("reason") || kept_[0].contains("next")) << "they belong to the verdict before";
}

TEST_F(ParamChangesTest, WhatTheSpineOrAPersonTakesBackIsReverted) {
  set({{"kp", 3.0}});
  wait_for([&] { return reaches_the_spine(); });
  spine_takes_it(3.0);
  tell(EventKind::params_reverted, command_.request_id, 0, "oscillating: joint elbow, 31 Hz");
  EXPECT_EQ(kept_[0]["verdict"], "reverted");
  EXPECT_EQ(kept_[0]["reason"], "oscillating: joint elbow, 31 Hz");
  EXPECT_EQ(kept_[0]["went_back_to"], (Json{{"kp", 2.0}}));
  EXPECT_EQ(kept_[0]["next"], std::string(next_step("oscillating: joint elbow")));
  EXPECT_EQ(std::get<Json>(answers_[0])["change"], changes_->last()["change"]) << "by which a client finds it";
  publish(7);
  set({{"kp", 3.5}});
  wait_for([&] { return reaches_the_spine(); });
  spine_takes_it(3.5);
  tell(EventKind::params_applied, 4711, 2, "as before the last change");
  EXPECT_EQ(kept_[1]["verdict"], "reverted");
  EXPECT_EQ(kept_[1]["reason"], "asked for");
  EXPECT_EQ(kept_[1]["went_back_to"], (Json{{"kp", 2.0}}));
}

TEST_F(ParamChangesTest, SeveralUnprovenChangesGoBackToTheValuesBeforeTheFirst) {
  set({{"kp", 3.0}});
  wait_for([&] { return reaches_the_spine(); });
  spine_takes_it(3.0);
  set({{"kp", 3.5}, {"kd", 0.06}});
  wait_for([&] { return reaches_the_spine(); });
  spine_takes_it(3.5, 0.06);
  tell(EventKind::params_reverted, command_.request_id, 0, "oscillating: joint elbow, 31 Hz");
  EXPECT_EQ(kept_[0]["went_back_to"], (Json{{"kp", 2.0}}));
  EXPECT_EQ(kept_[1]["went_back_to"], (Json{{"kp", 2.0}, {"kd", 0.05}}));
  const Json last = log_.since(log_.last() - 1, 1)["events"][0];
  EXPECT_EQ(last["kind"], "params_went_back") << "an incident has the values in its events";
  EXPECT_EQ(last["text"], "kp = 2 again, kd = 0.05 again");
}

TEST_F(ParamChangesTest, ValuesThatLeaveWithTheirLawAreToldSo) {
  set({{"kp", 3.0}});
  wait_for([&] { return reaches_the_spine(); });
  spine_takes_it(3.0);
  wire::Event event;
  event.kind = static_cast<std::uint32_t>(EventKind::law_rolled_back);
  event.code = 6;  // which runs now
  std::copy_n("overran", 7, event.text.begin());
  changes_->on_event(event);
  EXPECT_EQ(kept_[0]["verdict"], "rolled_back");
  EXPECT_EQ(kept_[0]["reason"], "with its law: overran");
  EXPECT_FALSE(kept_[0].contains("went_back_to"));
}

TEST_F(ParamChangesTest, EachIsTriedWithTheValuesThatHoldWhenItsTurnComes) {
  set({{"kp", 3.0}});
  set({{"kd", 0.06}});
  wait_for([&] { return reaches_the_spine(); });
  EXPECT_EQ(command_.count, 1U);
  spine_takes_it(3.0);
  wait_for([&] { return reaches_the_spine(); });
  EXPECT_EQ(command_.value[0], 0.06);
  spine_takes_it(3.0, 0.06);
  ASSERT_EQ(answers_.size(), 2U);
  EXPECT_EQ(kept_[1]["before"]["kd"], 0.05);
}

TEST_F(ParamChangesTest, OnesThatFollowWorseThanThoseInForceAreSetWithAWarningOfBothNumbers) {
  set({{"kp", 0.0}});
  wait_for([&] { return reaches_the_spine(); });
  spine_takes_it(0.0);
  const Json warnings = std::get<Json>(answers_.at(0))["warnings"];
  const auto about = [&](const std::string& part) {
    return std::any_of(warnings.begin(), warnings.end(),
                       [&](const Json& each) { return each.get<std::string>().find(part) != std::string::npos; });
  };
  EXPECT_TRUE(about("joint elbow follows its setpoint much worse than under spring, which runs now: ")) << warnings;
  EXPECT_TRUE(about(" rad against ")) << warnings;
}

TEST_F(ParamChangesTest, ALawThatIsReplacedMeanwhileKeepsItsOwnValues) {
  set({{"kp", 3.0}});
  set({{"kp", 3.5}});
  wait_for([&] { return reaches_the_spine(); });
  tick_->answer(ticket_, static_cast<std::uint32_t>(wire::CommandResult::refused_law));
  publish(8);
  commands_->serve(monotonic_ns());
  ASSERT_EQ(answers_.size(), 2U);
  EXPECT_EQ(refusal(0).code, "refused_law");
  EXPECT_EQ(refusal(1).code, "refused_law") << "it was asked of the law before";
  EXPECT_FALSE(reaches_the_spine());
}

TEST_F(ParamChangesTest, WrongNamesAndRangesAreRefusedAtOnceAndALawWithoutAnObjectIsNotLeftUntried) {
  set({{"kq", 1.0}});
  set({{"kp", 1000.0}});
  set(Json::object());
  ASSERT_EQ(answers_.size(), 3U);
  EXPECT_EQ(refusal(0).code, "unknown_param");
  EXPECT_EQ(refusal(1).code, "refused_range");
  EXPECT_EQ(refusal(2).code, "usage");
  laws_->forget(kRequest);
  set({{"kp", 3.0}});
  ASSERT_EQ(answers_.size(), 4U);
  EXPECT_EQ(refusal(3).code, "trial_unavailable");
  EXPECT_NE(refusal(3).next.find("swap the law in again"), std::string::npos);
}

TEST_F(ParamChangesTest, WithOpenGatesNothingIsTried) {
  make(nullptr);
  set({{"kp", -3.0}});
  EXPECT_TRUE(reaches_the_spine());
  spine_takes_it(-3.0);
  EXPECT_FALSE(std::get<Json>(answers_.at(0)).contains("trial_ms"));
}

TEST_F(ParamChangesTest, WhenTheRobotStopsEveryoneIsAnswered) {
  set({{"kp", 3.0}});
  set({{"kp", 3.5}});
  changes_->refuse_all({"stopping", "the robot is being stopped", ""});
  ASSERT_EQ(answers_.size(), 2U);
  EXPECT_EQ(refusal(1).code, "stopping");
}

TEST(ParamsOfASwap, AParameterIsHeldToTheNewLawsRange) {
  const Json law = {{"params", {{{"name", "kp"}, {"min", 0.0}, {"max", 2.0}}}}};
  EXPECT_FALSE(wrong_param({{"kp", 2.0}}, law));
  EXPECT_EQ(wrong_param({{"kp", 2.1}}, law)->code, "refused_range");
  EXPECT_EQ(wrong_param({{"kp", "much"}}, law)->code, "refused_range");
  EXPECT_EQ(wrong_param({{"kd", 1.0}}, law)->code, "unknown_param");
}

}  // namespace
}  // namespace lithe::control
