// SPDX-License-Identifier: Apache-2.0
// Sends commands to the Spine's mailbox and answers each of them once.
#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <variant>

#include "spine/robot/config.hpp"
#include "spine/wire/wire.hpp"
#include "supervisor/core/answer.hpp"
#include "supervisor/link/spine/spine_link.hpp"

namespace lithe::control {

// Whether this line of the Spine's log says what is wrong with buses and drives, or that nothing is.
bool tells_drives(std::string_view line);

// The Spine's refusal as a sentence, with the next step. `robot`, if given, tells the drives behind the joints;
// `drives_told` is the last line that tells_drives().
Refusal refusal_of(wire::CommandKind kind, wire::CommandResult result, const wire::Telemetry& now,
                   const wire::RobotInfo& info = {}, const robot::RobotConfig* robot = nullptr,
                   std::string_view drives_told = {});

// The first joint of a refused plan that is beyond its limit, with value and limit; empty when the reason is another.
std::string beyond_limits(const wire::Plan& plan, wire::PlanReject reason, const wire::RobotInfo& info);

// Makes the command that sets these parameters of this law. A refusal names the parameter.
std::variant<wire::Command, Refusal> params_command(const Json& values, const wire::LawInfo& law);

// Contract: one thread · never blocks · serve() at least every millisecond while waiting().
class Commands {
 public:
  using Callback = std::function<void(const Answer&)>;
  static constexpr std::int64_t kTimeoutNs = 2'000'000'000;
  // An `arm` that is refused because of one late sample is sent again for this long: on a busy machine commands often
  // arrive in a tick whose sample is late. A `disarm` or `estop` that was sent after it ends that.
  static constexpr std::int64_t kArmAgainNs = 200'000'000;

  // `robot`, `drives_told`: outlive it; for the words of refusals.
  Commands(SpineLink& spine, std::uint64_t first_request_id, const robot::RobotConfig* robot = nullptr,
           const std::string* drives_told = nullptr)
      : spine_(spine), next_id_(first_request_id), robot_(robot), drives_told_(drives_told) {}

  // Returns the request id that the events carry; 0 = refused at once.
  std::uint64_t send(wire::Command command, Callback callback, std::int64_t now_ns);
  void serve(std::int64_t now_ns);
  void refuse_all(const Refusal& reason);
  // From now on every command but `disarm` and `estop` is refused.
  void close(const Refusal& reason) { closed_ = reason; }
  bool waiting() const { return !pending_.empty(); }

 private:
  struct Pending {
    wire::Command command;
    std::uint64_t ticket;
    std::int64_t sent_ns;
    std::uint64_t seen_at_tick;  // the first tick whose telemetry shows the effect; 0 = not answered yet
    Callback callback;
  };

  Json result_json(const wire::Telemetry& now) const;

  SpineLink& spine_;
  std::uint64_t next_id_;
  std::uint64_t newest_stop_ = 0;  // request id of the last `disarm` or `estop`
  std::optional<Refusal> closed_;
  const robot::RobotConfig* robot_;
  const std::string* drives_told_;
  std::deque<Pending> pending_;
};

}  // namespace lithe::control
