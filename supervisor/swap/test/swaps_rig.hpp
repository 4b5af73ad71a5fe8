// SPDX-License-Identifier: Apache-2.0
// For tests: swaps against the real compile service and real segments; what the Spine says is written by hand.
#pragma once

#include <gtest/gtest.h>
#include <poll.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "spine/core/time.hpp"
#include "supervisor/link/spine/test/spine_rig.hpp"
#include "supervisor/swap/swaps.hpp"

namespace lithe::control {

class SwapsRig : public SpineRig {
 protected:
  using EventKind = wire::EventKind;
  static constexpr std::uint64_t kFirst = 100;  // request id

  SwapsRig() : dir_(std::filesystem::temp_directory_path() / robot_) {}
  void SetUp() override {
    attach([this](wire::RobotInfo& info) {
      info.rate_hz = 1000;
      describe(info);
    });
    loader_.emplace((*control_)->stage, (*spine_)->stage_ack);
    commands_.emplace(*link_, 1);
    lawd_.open_gates();
    ASSERT_TRUE(lawd_.start(monotonic_ns()));
    swaps_.emplace(Swaps::Helpers{*link_, lawd_, nullptr, *commands_, log_}, CertificateFiles(dir_), kFirst,
                   robot::RobotConfig{});
  }
  virtual void describe(wire::RobotInfo&) {}
  void TearDown() override { std::filesystem::remove_all(dir_); }

  void turn_until(const std::function<bool()>& done) {
    const std::int64_t deadline_ns = monotonic_ns() + 60 * kNsPerS;
    while (!done() && monotonic_ns() < deadline_ns) {
      pollfd wait{lawd_.poll_fd(), POLLIN, 0};
      ::poll(&wait, 1, 10);
      lawd_.serve(monotonic_ns());
      swaps_->serve(monotonic_ns());
    }
  }
  void wait_for_answers(std::size_t count) {
    turn_until([&] { return answers_.size() >= count; });
    ASSERT_EQ(answers_.size(), count);
  }
  void submit(const SwapRequest& request) {
    swaps_->submit(request, [this](const Answer& answer) { answers_.push_back(answer); }, monotonic_ns());
  }
  const Refusal& refusal(std::size_t i) const { return std::get<Refusal>(answers_.at(i)); }
  // A swap, up to the request that the Loader finds in its mailbox.
  void ask(Json params = Json::object(), double shadow_s = 0) {
    SwapRequest request{"rest.cpp", kRestLaw, std::move(params)};
    request.terms.shadow_s = shadow_s;
    submit(request);
    wire::StageRequest staged;
    turn_until([&] { return loader_->receive(staged, ticket_); });
    request_id_ = staged.request_id;
    staged_ = staged;
    ASSERT_NE(request_id_, 0U);
  }
  void tell(EventKind kind, std::uint32_t code, std::uint64_t tick, double value = 0, const std::string& text = "") {
    wire::Event event;
    event.value = value;
    std::copy_n(text.begin(), std::min(text.size(), event.text.size() - 1), event.text.begin());
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
    record->mode = static_cast<std::uint32_t>(wire::Mode::active);
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
  void commits(std::uint32_t law_id, std::uint64_t tick) {
    tell(EventKind::law_committed, law_id, tick);
    EXPECT_TRUE(answers_.empty()) << "the answer waits for the tick that shows the law";
    publish(tick + 1, law_id);
    swaps_->serve(monotonic_ns());
    ASSERT_EQ(answers_.size(), 1U);
  }
  Json certificate(const char* file_name = "0001.json") const {
    std::ifstream file(dir_ / file_name);
    return Json::parse(file, nullptr, false);
  }

  std::filesystem::path dir_;
  std::optional<ipc::MailboxReceiver<wire::StageRequest, wire::control_segment::kStageDepth>> loader_;
  LawdLink lawd_{LITHE_LAWD, {}, 1};
  std::optional<Commands> commands_;
  EventLog log_;
  std::vector<Answer> answers_;
  std::uint64_t ticket_ = 0, request_id_ = 0;
  wire::StageRequest staged_;
  std::optional<Swaps> swaps_;
};

}  // namespace lithe::control
