// SPDX-License-Identifier: Apache-2.0
// Against real segments; compile service and trial are not started, the Spine is not there.
#include "supervisor/serve/verbs.hpp"

#include <gtest/gtest.h>

#include <filesystem>
#include <memory>
#include <optional>
#include <vector>

#include "supervisor/link/spine/test/spine_rig.hpp"

namespace lithe::control {
namespace {

// Laws law1, law2 and law3, of which the last one runs.
class VerbsTest : public SpineRig {
 protected:
  void SetUp() override {
    attach([](wire::RobotInfo& info) { info.joint_count = 1; });
    for (std::uint32_t id = 1; id <= 3; ++id) {
      wire::LawInfo law;
      law.law_id = id;
      law.name = {'l', 'a', 'w', static_cast<char>('0' + id)};
      ipc::ChannelWriter<wire::LawInfo>((*spine_)->law_info[id]).write(law);
    }
    auto record = std::make_unique<wire::Telemetry>();
    record->tick = 1;
    record->law_id = 3;
    ipc::RingWriter<wire::Telemetry, wire::spine_segment::kTelemetryDepth>((*spine_)->telemetry).push(*record);
    tick_.emplace((*control_)->commands, (*spine_)->control_ack);
    commands_.emplace(*link_, 1);
    swaps_.emplace(Swaps::Helpers{*link_, lawd_, nullptr, *commands_, log_}, CertificateFiles(folder_), 1, config_);
    verbs_.emplace(
        Parts{config_, *link_, lawd_, trial_, *commands_, *swaps_, incidents_, log_, throttle_, false, shield_,
              drives_told_},
        [this](const ReplyTo&, const Answer& answer) { answers_.push_back(answer); }, [] {});
  }
  // The command that reached the Spine; empty: none.
  std::optional<wire::Command> asked(const std::string& verb, const Json& args) {
    verbs_->handle({}, verb, args);
    wire::Command command;
    std::uint64_t ticket = 0;
    if (!tick_->receive(command, ticket)) return std::nullopt;
    return command;
  }

  std::filesystem::path folder_ = std::filesystem::temp_directory_path() / robot_;  // nothing is written
  robot::RobotConfig config_;
  LawdLink lawd_{"lawd", {}, 1};
  TrialLink trial_{"lithe-trial", "robot.toml", {}};
  EventLog log_;
  Incidents incidents_{folder_, log_};
  host::ThrottleWatch throttle_;
  Json shield_ = nullptr;
  std::string drives_told_;
  std::vector<Answer> answers_;
  std::optional<ipc::MailboxReceiver<wire::Command, wire::control_segment::kCommandsDepth>> tick_;
  std::optional<Commands> commands_;
  std::optional<Swaps> swaps_;
  std::optional<Verbs> verbs_;
};

TEST_F(VerbsTest, AWayBackNamesTheLawThatItsStepsWereCountedFrom) {
  const auto activated = asked("activate", {{"law", "law1"}});
  ASSERT_TRUE(activated);
  EXPECT_EQ(activated->kind, static_cast<std::uint32_t>(wire::CommandKind::rollback));
  EXPECT_EQ(activated->count, 2U);
  EXPECT_EQ(activated->law_id, 3U);
  const auto rolled_back = asked("rollback", Json::object());
  ASSERT_TRUE(rolled_back);
  EXPECT_EQ(rolled_back->count, 1U);
  EXPECT_EQ(rolled_back->law_id, 3U);
  EXPECT_TRUE(answers_.empty()) << "the Spine has not answered";
}

TEST_F(VerbsTest, TheLawThatRunsIsActivatedWithoutTheSpine) {
  EXPECT_FALSE(asked("activate", {{"law", 3U}}));
  ASSERT_EQ(answers_.size(), 1U);
  EXPECT_EQ(std::get<Json>(answers_[0])["law"], "law3");
}

}  // namespace
}  // namespace lithe::control
