// SPDX-License-Identifier: Apache-2.0
// Against the real compile service and real segments; what the Spine says is written by hand.
#include "supervisor/control/swaps.hpp"

#include <gtest/gtest.h>
#include <poll.h>
#include <unistd.h>

#include <fstream>
#include <memory>
#include <optional>
#include <vector>

#include "spine/core/time.hpp"
#include "supervisor/swap/chain.hpp"

namespace lithe::control {
namespace {

namespace fs = std::filesystem;
using swap::Answer;
using swap::Json;
using swap::Refusal;
using wire::EventKind;

constexpr const char* kLaw =
    "#include <lithe/law.hpp>\n"
    "struct Rest {\n"
    "  struct Params { lithe::Param gain{1.0, 0.0, 2.0}; };\n"
    "  struct State { double last_rad = 0.0; };\n"
    "  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& e) {\n"
    "    s.last_rad = t.position_rad[0]; e.torque_nm[0] = -p.gain * t.velocity_rad_s[0];\n"
    "  }\n"
    "};\n"
    "LITHE_LAW(Rest, \"rest\");\n";
constexpr std::uint64_t kFirst = 100;  // request id
const Refusal kGone{"robot_fault", "the Spine is gone", "start again"};

class SwapsTest : public testing::Test {
 protected:
  SwapsTest() : dir_(fs::temp_directory_path() / robot_) {}
  void SetUp() override {
    spine_.emplace(std::move(*ipc::Segment<ipc::SpineMemory>::create(robot_)));
    control_.emplace(std::move(*ipc::Segment<ipc::ControlMemory>::create(robot_)));
    auto info = std::make_unique<wire::RobotInfo>();
    info->rate_hz = 1000;
    ipc::ChannelWriter<wire::RobotInfo>((*spine_)->robot_info).write(*info);
    loader_.emplace((*control_)->stage, (*spine_)->stage_ack);
    tick_.emplace((*control_)->commands, (*spine_)->control_ack);
    auto link = SpineLink::attach(robot_);
    ASSERT_TRUE(link) << link.message();
    link_.emplace(std::move(*link));
    commands_.emplace(*link_, 1);
    lawd_.open_gates();
    ASSERT_TRUE(lawd_.start(monotonic_ns()));
    swaps_.emplace(Swaps::Helpers{*link_, lawd_, nullptr, *commands_, log_}, swap::RecordBook(dir_), kFirst,
                   robot::RobotConfig{});
  }
  void TearDown() override {
    ipc::remove_segment(ipc::Segment<ipc::SpineMemory>::path(robot_));
    ipc::remove_segment(ipc::Segment<ipc::ControlMemory>::path(robot_));
    fs::remove_all(dir_);
  }

  // A swap, up to the request that the Loader finds in its mailbox.
  void ask(Json params = Json::object()) {
    swap::Request request{"rest.cpp", kLaw, std::move(params)};
    swaps_->submit(request, [this](const Answer& answer) { answers_.push_back(answer); }, monotonic_ns());
    const std::int64_t deadline_ns = monotonic_ns() + 60 * kNsPerS;
    wire::StageRequest staged;
    while (!loader_->receive(staged, ticket_) && monotonic_ns() < deadline_ns) {
      pollfd wait{lawd_.poll_fd(), POLLIN, 0};
      ::poll(&wait, 1, 10);
      lawd_.serve(monotonic_ns());
      swaps_->serve(monotonic_ns());
    }
    request_id_ = staged.request_id;
    ASSERT_NE(request_id_, 0U);
  }
  void tell(EventKind kind, std::uint32_t code, std::uint64_t tick) {
    wire::Event event;
    event.kind = static_cast<std::uint32_t>(kind);
    event.request_id = request_id_;
    event.code = code;
    event.tick = tick;
    event.t_ns = monotonic_ns();
    swaps_->on_event(event, event.t_ns);
  }
  void publish(std::uint64_t tick, std::uint32_t law_id) {
    auto record = std::make_unique<wire::Telemetry>();
    record->tick = tick;
    record->law_id = law_id;
    ipc::RingWriter<wire::Telemetry, wire::spine_segment::kTelemetryDepth>((*spine_)->telemetry).push(*record);
    wire::LawInfo info;
    info.law_id = law_id;
    info.request_id = request_id_;
    info.param_count = 1;
    info.param_name = {'g', 'a', 'i', 'n'};
    info.param_max[0] = 2;
    ipc::ChannelWriter<wire::LawInfo>((*spine_)->law_info[0]).write(info);
  }
  // The Spine's answer to the parameters, and the tick that shows them.
  void answer_params(wire::CommandResult result, std::uint64_t tick) {
    wire::Command command;
    std::uint64_t ticket = 0;
    ASSERT_TRUE(tick_->receive(command, ticket));
    EXPECT_EQ(command.kind, static_cast<std::uint32_t>(wire::CommandKind::set_params));
    tick_->answer(ticket, static_cast<std::uint32_t>(result));
    commands_->serve(monotonic_ns());
    publish(tick, 7);
    publish(tick + 1, 7);
    commands_->serve(monotonic_ns());
  }
  Json certificate() const {
    std::ifstream file(dir_ / "0001.json");
    return Json::parse(file, nullptr, false);
  }

  std::string robot_ = "swaps" + std::to_string(::getpid());
  fs::path dir_;
  std::optional<ipc::Segment<ipc::SpineMemory>> spine_;
  std::optional<ipc::Segment<ipc::ControlMemory>> control_;
  std::optional<ipc::MailboxReceiver<wire::StageRequest, wire::control_segment::kStageDepth>> loader_;
  std::optional<ipc::MailboxReceiver<wire::Command, wire::control_segment::kCommandsDepth>> tick_;
  std::optional<SpineLink> link_;
  LawdLink lawd_{LITHE_LAWD, {}, 1};
  std::optional<Commands> commands_;
  EventLog log_;
  std::vector<Answer> answers_;
  std::uint64_t ticket_ = 0;
  std::uint64_t request_id_ = 0;
  std::optional<Swaps> swaps_;
};

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
  EXPECT_EQ(std::get<Refusal>(answers_[0]).code, "timeout");
  EXPECT_EQ(certificate()["verdict"], "not_confirmed");
  tell(EventKind::law_committed, 7, 500);
  EXPECT_EQ(answers_.size(), 1U) << "one answer";
  EXPECT_EQ(certificate()["verdict"], "committed");
  EXPECT_EQ(certificate()["commit_tick"], 500);
  EXPECT_EQ(certificate()["answered"]["verdict"], "not_confirmed");
  EXPECT_EQ(certificate()["params"]["taken"], false) << "nobody set them";
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

TEST_F(SwapsTest, TheCertificateTellsWhichParametersWereTaken) {
  ask({{"gain", 1.5}});
  publish(499, 7);
  tell(EventKind::law_committed, 7, 500);
  publish(501, 7);
  swaps_->serve(monotonic_ns());
  EXPECT_TRUE(answers_.empty()) << "it comes when they are set";
  EXPECT_TRUE(certificate()["params"]["taken"].is_null());
  answer_params(wire::CommandResult::done, 502);
  ASSERT_EQ(answers_.size(), 1U);
  EXPECT_EQ(std::get<Json>(answers_[0])["params"]["taken"], true);
  EXPECT_EQ(certificate()["params"]["taken"], true);
  EXPECT_EQ(certificate()["params"]["values"]["gain"], 1.5);
}

TEST_F(SwapsTest, ParametersThatTheSpineRefusesAreInTheCertificateOfTheLawThatRunsWithoutThem) {
  ask({{"gain", 1.5}});
  publish(499, 7);
  tell(EventKind::law_committed, 7, 500);
  publish(501, 7);
  swaps_->serve(monotonic_ns());
  answer_params(wire::CommandResult::refused_law, 502);
  ASSERT_EQ(answers_.size(), 1U);
  EXPECT_EQ(std::get<Refusal>(answers_[0]).code, "refused_law");
  EXPECT_EQ(certificate()["verdict"], "committed");
  EXPECT_EQ(certificate()["params"]["taken"], false);
  EXPECT_EQ(certificate()["params"]["error"]["code"], "refused_law");
}

TEST_F(SwapsTest, ALawIsMeasuredBeforeTheNextOneComesNearTheSpine) {
  ask();
  publish(499, 1);
  tell(EventKind::law_staged, 7, 0);
  tell(EventKind::law_committed, 7, 500);
  publish(501, 7);
  swaps_->serve(monotonic_ns());
  ASSERT_EQ(answers_.size(), 1U);
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

}  // namespace
}  // namespace lithe::control
