// SPDX-License-Identifier: Apache-2.0
// Sends commands to the Spine's mailbox and answers each of them once.
#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <variant>

#include "spine/robot/config.hpp"
#include "spine/wire/wire.hpp"
#include "supervisor/core/answer.hpp"
#include "supervisor/link/spine/spine_link.hpp"

namespace lithe::control {

// What this line of the Spine's log says is wrong with buses and drives; empty: nothing is. No value: another line.
std::optional<std::string> drives_told_in(std::string_view line);

// What is known of the drives behind the joints, for the words of refusals.
struct DriveFacts {
  const robot::RobotConfig* robot = nullptr;
  std::string_view told{};                                                             // the last drives_told_in()
  std::string (*words)(robot::DeviceKind kind, std::uint32_t joint_status) = nullptr;  // what the drive reports
};

// The Spine's refusal as a sentence, with the next step. A drive that reports a fault makes it `refused_fault`.
Refusal refusal_of(wire::CommandKind kind, wire::CommandResult result, const wire::Telemetry& now,
                   const wire::RobotInfo& info = {}, const DriveFacts& drives = {});

// Makes the command that sets these parameters of this law. A refusal names the parameter.
std::variant<wire::Command, Refusal> params_command(const Json& values, const wire::LawInfo& law);

// Contract: one thread · never blocks · serve() at least every millisecond while waiting().
class Commands {
 public:
  using Callback = std::function<void(const Answer&)>;
  static constexpr std::int64_t kTimeoutNs = 2'000'000'000;
  // An `arm` that is refused because of one late sample, or a fault that its drive has just cleared, is sent again for
  // this long. A `disarm` or `estop` that was sent after it ends that.
  static constexpr std::int64_t kArmAgainNs = 200'000'000;
  // `arm` is answered when every drive has torque, or after this time: some drives fail only then.
  static constexpr std::int64_t kDrivenNs = 500'000'000;
  // Longer than the Spine brakes before it switches the drives off.
  static constexpr std::int64_t kBrakingNs = 4'000'000'000;

  Commands(SpineLink& spine, std::uint64_t first_request_id, std::function<DriveFacts()> drives = {})
      : spine_(spine), next_id_(first_request_id), drives_(std::move(drives)) {}

  // Returns the request id that the events carry; 0 = refused at once.
  std::uint64_t send(wire::Command command, Callback callback, std::int64_t now_ns);
  void serve(std::int64_t now_ns);
  void refuse_all(const Refusal& reason);
  // From now on every command but `disarm` and `estop` is refused.
  void close(const Refusal& reason) { closed_ = reason; }
  bool waiting() const { return !pending_.empty(); }

 private:
  // The fastest joint.
  struct Moving {
    std::string joint;
    double rad_s = 0;
  };
  struct Pending {
    wire::Command command;
    std::uint64_t ticket;
    std::int64_t sent_ns;
    std::uint64_t seen_at_tick;  // the first tick whose telemetry shows the effect; 0 = not answered yet
    Callback callback;
    Moving moving;  // when it was sent
  };

  // The Spine brakes a moving joint first.
  static bool switches_off(wire::CommandKind kind);
  Moving moving() const;
  static Json result_json(const Pending& done, const wire::Telemetry& now, std::int64_t now_ns);

  SpineLink& spine_;
  std::uint64_t next_id_;
  std::uint64_t newest_stop_ = 0;  // request id of the last `disarm` or `estop`
  std::optional<Refusal> closed_;
  std::function<DriveFacts()> drives_;
  std::deque<Pending> pending_;
};

}  // namespace lithe::control
