// SPDX-License-Identifier: Apache-2.0
#include "supervisor/control/commands.hpp"

#include <fmt/format.h>

#include <cmath>
#include <utility>

namespace lithe::control {

using swap::Answer;
using swap::Json;
using swap::Refusal;
using wire::CommandKind;
using wire::CommandResult;

swap::Refusal refusal_of(CommandKind kind, CommandResult result, const wire::Telemetry& now) {
  const std::string verb(to_string(kind));
  const std::string code(to_string(result));
  const std::string mode(to_string(static_cast<wire::Mode>(now.mode)));
  const std::string fault(to_string(static_cast<wire::Fault>(now.fault)));
  switch (result) {
    case CommandResult::refused_mode:
      if (kind == CommandKind::reset) {
        return {code, "there is nothing to reset: no fault is latched", "arm the robot"};
      }
      return {code, fmt::format("cannot {} in mode {}", verb, mode), "arm first: lithe arm"};
    case CommandResult::refused_estop:
      return {code, fmt::format("cannot {}: the e-stop is pressed", verb),
              kind == CommandKind::reset
                  ? "a Brain holds it: reset from there (robot.reset()), or end that Brain and reset again"
                  : "when it is safe: lithe reset, then lithe arm"};
    case CommandResult::refused_fault:
      return {code, fmt::format("cannot {}: fault {} is latched", verb, fault), "find the cause, then: lithe reset"};
    case CommandResult::refused_law:
      return {code,
              kind == CommandKind::rollback ? "there is no previous law to go back to"
                                            : fmt::format("cannot {}: no such law is running", verb),
              kind == CommandKind::rollback ? "swap a law in instead" : "swap a law in: lithe swap laws/hold.cpp"};
    case CommandResult::refused_range:
      return {code, "a parameter is outside its range or does not exist", "see the ranges: lithe param get"};
    case CommandResult::refused_not_ready:
      return {code, fmt::format("cannot {}: not every drive answers yet", verb),
              "try again; lithe status names joints"};
    default:
      return {code, fmt::format("the Spine does not know the command {}", verb), "build both from the same source"};
  }
}

void Commands::send(wire::Command command, Callback callback, std::int64_t now_ns) {
  command.request_id = next_id_++;
  const auto ticket = spine_.send(command);
  if (!ticket) {
    callback(Refusal{"busy", "the Spine has sixteen unread commands", "try again; if it stays so, lithe status"});
    return;
  }
  pending_.push_back({command, *ticket, now_ns, 0, std::move(callback)});
}

void Commands::set_params(const Json& values, Callback callback, std::int64_t now_ns, std::uint32_t law_id) {
  wire::Telemetry now;
  const auto law = spine_.latest(now) ? spine_.law(law_id != 0 ? law_id : now.law_id) : std::nullopt;
  if (!law) {
    callback(Refusal{"refused_law", "no law is running, so there is no parameter to set", "swap a law in first"});
    return;
  }
  wire::Command command;
  command.kind = static_cast<std::uint32_t>(CommandKind::set_params);
  command.law_id = law->law_id;
  for (const auto& [name, value] : values.items()) {
    std::uint32_t index = 0;
    std::string known;
    while (index < law->param_count && text_of(law->param_name, index * 32, 32) != name) {
      known += (known.empty() ? "" : ", ") + text_of(law->param_name, index * 32, 32);
      ++index;
    }
    if (index == law->param_count) {
      callback(Refusal{"unknown_param", fmt::format("law '{}' has no parameter '{}'", text_of(law->name), name),
                       known.empty() ? "it has none" : fmt::format("it has: {}", known)});
      return;
    }
    if (!value.is_number() || !(value >= law->param_min[index]) || !(value <= law->param_max[index])) {
      callback(Refusal{
          "refused_range",
          fmt::format("{} = {} is outside [{}, {}]", name, value.dump(), law->param_min[index], law->param_max[index]),
          "nothing was changed; choose a value inside the range"});
      return;
    }
    command.index[command.count] = index;
    command.value[command.count] = value.get<double>();
    ++command.count;
  }
  if (command.count == 0) {
    callback(Refusal{"usage", "no parameter was given", "lithe param set NAME VALUE"});
    return;
  }
  send(command, std::move(callback), now_ns);
}

void Commands::refuse_all(const Refusal& reason) {
  for (; !pending_.empty(); pending_.pop_front()) {
    pending_.front().callback(reason);
  }
}

Json Commands::result_json(const wire::Telemetry& now) const {
  return {{"mode", std::string(to_string(static_cast<wire::Mode>(now.mode)))},
          {"fault", std::string(to_string(static_cast<wire::Fault>(now.fault)))},
          {"tick", now.tick}};
}

void Commands::serve(std::int64_t now_ns) {
  wire::Telemetry now{};
  (void)spine_.latest(now);
  // Answers may come out of order (a client's callback may also send again), so each is looked at once per turn.
  for (std::size_t left = pending_.size(); left > 0; --left) {
    Pending each = std::move(pending_.front());
    pending_.pop_front();
    const auto kind = static_cast<CommandKind>(each.command.kind);
    const CommandResult result = spine_.poll(each.ticket);
    const bool in_time = now_ns - each.sent_ns < kTimeoutNs;
    const bool again =
        kind == CommandKind::arm && result == CommandResult::refused_not_ready && now_ns - each.sent_ns < kArmAgainNs;
    if (const auto ticket = again ? spine_.send(each.command) : std::nullopt) {
      each.ticket = *ticket;
      pending_.push_back(std::move(each));
    } else if (result == CommandResult::pending && in_time) {
      pending_.push_back(std::move(each));
    } else if (result == CommandResult::pending) {
      each.callback(Refusal{"timeout", fmt::format("the Spine did not answer {} within 2 s", to_string(kind)),
                            "is it alive? lithe status"});
    } else if (result != CommandResult::done) {
      each.callback(refusal_of(kind, result, now));
    } else if (each.seen_at_tick == 0) {
      each.seen_at_tick = now.tick + 1;  // the tick that obeyed publishes its record after its answer
      pending_.push_back(std::move(each));
    } else if (now.tick < each.seen_at_tick && in_time) {
      pending_.push_back(std::move(each));
    } else {
      each.callback(result_json(now));
    }
  }
}

}  // namespace lithe::control
