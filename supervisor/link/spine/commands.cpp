// SPDX-License-Identifier: Apache-2.0
#include "supervisor/link/spine/commands.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

namespace lithe::control {

using wire::CommandKind;
using wire::CommandResult;

namespace {

constexpr const char* kNewStart = "find the cause (lithe events), then start again: lithe stop, lithe run";

// When a joint is outside its limits, the next step is `recover`.
std::string way_out_of(wire::Fault fault) {
  if (fault == wire::Fault::memory_damaged) return kNewStart;
  const bool outside = fault == wire::Fault::position_limit || fault == wire::Fault::recover_failed;
  return fmt::format("find the cause of {} (lithe events), then: {}, then lithe arm", to_string(fault),
                     outside ? "lithe recover" : "lithe reset");
}

// The next step that leads from this mode and latched fault to a running law.
std::string way_to_active(wire::Mode mode, wire::Fault fault) {
  switch (mode) {
    case wire::Mode::estop:
      return "when it is safe: lithe reset, then lithe arm";
    case wire::Mode::safe_stop:
      if (fault == wire::Fault::none) return "it brakes, and is off then: wait a moment, then: lithe arm";
      return way_out_of(fault);
    case wire::Mode::recover:
      return "wait until every joint is inside (lithe status), then: lithe arm";
    case wire::Mode::disarmed:
      return fault == wire::Fault::none ? "arm first: lithe arm" : way_out_of(fault);
    default:
      return "the robot is running again by now: try once more";
  }
}

Refusal refused_by_mode(CommandKind kind, wire::Mode mode, wire::Fault fault) {
  const std::string code(to_string(CommandResult::refused_mode));
  if (kind == CommandKind::recover || kind == CommandKind::sim_reset) {
    return {code, fmt::format("cannot {} in mode {}", to_string(kind), to_string(mode)),
            fmt::format("switch the drives off first: lithe {}, then: lithe {}",
                        mode == wire::Mode::estop ? "reset" : "disarm",
                        kind == CommandKind::recover ? "recover" : "sim reset")};
  }
  if (kind != CommandKind::reset)
    return {code, fmt::format("cannot {} in mode {}", to_string(kind), to_string(mode)), way_to_active(mode, fault)};
  const bool off = mode == wire::Mode::disarmed;
  return {code, fmt::format("there is nothing to reset: no fault is latched in mode {}", to_string(mode)),
          off ? "arm the robot: lithe arm" : "nothing is in its way; lithe disarm switches the drives off"};
}

Refusal refused_by_estop(CommandKind kind) {
  const std::string code(to_string(CommandResult::refused_estop));
  const std::string message = fmt::format("cannot {}: the e-stop is pressed", to_string(kind));
  if (kind == CommandKind::reset)
    return {code, message,
            "a Brain holds it: reset from there (robot.reset(); a gateway's client: the verb reset), or end "
            "that Brain and reset again"};
  return {code, message,
          kind == CommandKind::disarm ? "the law is off already; lithe reset leaves the e-stop with the drives off"
                                      : "when it is safe: lithe reset, then lithe arm"};
}

constexpr std::uint32_t kReportsFault = wire::joint_status::kFault | wire::joint_status::kWatchdog;

// What the Spine said last of this drive: "drive 'knee_drive': REASON; drive 'toe_drive': REASON".
std::string told_of(std::string_view drives_told, std::string_view drive) {
  const std::string head = fmt::format("drive '{}': ", drive);
  const std::size_t at = drives_told.find(head);
  if (at == std::string_view::npos) return "";
  std::string_view told = drives_told.substr(at + head.size());
  for (const std::string_view other : {"; drive '", "; device '", "; bus '"}) told = told.substr(0, told.find(other));
  return std::string(told);
}

const robot::DeviceConfig* drive_of(const DriveFacts& drives, std::size_t joint) {
  const robot::RobotConfig* robot = drives.robot;
  if (robot == nullptr || joint >= robot->joints.size()) return nullptr;
  const std::size_t device = robot->joints[joint].device;
  return device < robot->devices.size() ? &robot->devices[device] : nullptr;
}

// What is known of the joint's drive: what it reports itself, and our driver's reason. Empty: nothing.
std::string said_of(const DriveFacts& drives, std::size_t joint, std::uint32_t status) {
  const robot::DeviceConfig* drive = drive_of(drives, joint);
  if (drive == nullptr) return "";
  std::string told = told_of(drives.told, drive->name);
  if ((status & kReportsFault) == 0 || drives.words == nullptr) return told;
  return fmt::format("its drive reports {}{}{}", drives.words(drive->kind, status), told.empty() ? "" : "; ", told);
}

// The command was done, and the robot has stopped by the time that the effect can be seen.
bool has_stopped(CommandKind kind, const wire::Telemetry& now) {
  const bool moves = kind == CommandKind::arm || kind == CommandKind::hold || kind == CommandKind::recover;
  const auto mode = static_cast<wire::Mode>(now.mode);
  return moves && (mode == wire::Mode::safe_stop || mode == wire::Mode::estop);
}

bool all_driven(const wire::Telemetry& now) {
  const auto joints = std::min<std::size_t>(now.joint_count, wire::kNj);
  return std::ranges::all_of(now.drive_state.begin(), now.drive_state.begin() + joints, [](std::uint32_t state) {
    return static_cast<wire::DriveState>(state) == wire::DriveState::driven;
  });
}

Refusal stopped_at_once(CommandKind kind, const wire::Telemetry& now, const wire::RobotInfo& info,
                        const DriveFacts& drives) {
  const auto fault = static_cast<wire::Fault>(now.fault);
  std::string joints;
  for (std::size_t j = 0; j < std::min<std::size_t>(now.joint_count, wire::kNj); ++j) {
    const auto own = static_cast<wire::Fault>(now.joint_fault[j]);
    if (own == wire::Fault::none) continue;
    const std::string said = said_of(drives, j, now.joint_status[j]);
    joints += fmt::format("; joint {}: {}{}", joint_name(info, j), to_string(own), said.empty() ? "" : ", " + said);
  }
  const bool of_law = fault == wire::Fault::law_faulted || fault == wire::Fault::law_not_finite;
  const auto mode = static_cast<wire::Mode>(now.mode);
  return {std::string(to_string(CommandResult::refused_fault)),
          fmt::format("{} was done, and the robot is in {} at once: {}{}", to_string(kind), to_string(mode),
                      to_string(fault), joints),
          of_law ? "if its law fails in every first tick, put another in: lithe swap hold; then lithe reset, lithe arm"
                 : way_to_active(mode, fault),
          {{"mode", std::string(to_string(mode))}, {"fault", std::string(to_string(fault))}, {"tick", now.tick}}};
}

Refusal refused_by_law(CommandKind kind) {
  const std::string code(to_string(CommandResult::refused_law));
  switch (kind) {
    case CommandKind::rollback:
      return {code, "there are not so many laws to go back to, or another law runs by now; nothing was changed",
              "see which are there: lithe law list; or swap one in"};
    case CommandKind::revert_params:
    case CommandKind::set_params:
      return {code, "another law runs by now, or none; no parameter was changed", "see what runs: lithe param get"};
    default:
      return {code, fmt::format("cannot {}: no law is loaded", to_string(kind)),
              "swap a law in (lithe swap hold), then: lithe arm"};
  }
}

// Names the joints that are outside their limits, with angle and limit.
Refusal refused_outside(CommandKind kind, const wire::Telemetry& now, const wire::RobotInfo& info) {
  std::string joints;
  for (std::size_t j = 0; j < std::min<std::size_t>(now.joint_count, wire::kNj); ++j) {
    const double rad = now.position_rad[j], min = info.position_min_rad[j], max = info.position_max_rad[j];
    if (rad >= min && rad <= max) continue;
    joints += fmt::format("{}{} is at {:.3f} rad, its limit is {:.3f} rad", joints.empty() ? "" : "; ",
                          joint_name(info, j), rad, rad > max ? max : min);
  }
  if (joints.empty()) joints = "a joint was outside its limits";
  return {std::string(to_string(CommandResult::refused_outside)), fmt::format("cannot {}: {}", to_string(kind), joints),
          static_cast<wire::Mode>(now.mode) == wire::Mode::recover
              ? "wait until every joint is inside (lithe status), then: lithe arm"
              : "bring it inside: lithe recover (slow, little torque), or by hand; then: lithe arm"};
}

constexpr robot::Advice kNotSetUp{"is not set up as a command would need it; the log says what to set", ""};
constexpr std::string_view kTryAgain = "try again; lithe status names the joints that are stale";

// What keeps a joint from being armed, and the next step; no text = nothing.
robot::Advice why_not_ready(std::uint32_t status, const robot::DeviceConfig* drive) {
  if ((status & wire::joint_status::kFresh) == 0) return {"does not answer, or is being set up", ""};
  if ((status & wire::joint_status::kNotReady) == 0) {
    if ((status & kReportsFault) == 0) return {};
    return {"reports a fault", "find its cause (lithe status); when it is over: lithe reset, then lithe arm"};
  }
  const robot::Advice own = drive != nullptr ? robot::facts(drive->kind).not_ready : robot::Advice{};
  return own.text.empty() ? kNotSetUp : own;
}

// Names the joints and their drives. None: it was one late sample.
Refusal refused_not_ready(CommandKind kind, const wire::Telemetry& now, const wire::RobotInfo& info,
                          const DriveFacts& drives) {
  std::string joints;
  std::string_view next;
  bool fault = false;
  for (std::size_t j = 0; j < std::min<std::size_t>(now.joint_count, wire::kNj); ++j) {
    const std::uint32_t status = now.joint_status[j];
    const robot::DeviceConfig* drive = drive_of(drives, j);
    const robot::Advice why = why_not_ready(status, drive);
    if (why.text.empty()) continue;
    const bool reports = (status & kReportsFault) != 0;
    const std::string told = said_of(drives, j, status);
    fault = fault || reports;
    if (next.empty()) next = told.empty() || reports ? why.next : "when that is done: lithe arm";
    joints += fmt::format("{}joint {}{}{}", joints.empty() ? ": " : "; ", joint_name(info, j),
                          drive != nullptr ? fmt::format(" (drive {})", drive->name) : "",
                          told.empty() ? fmt::format(" {}", why.text) : ": " + told);
  }
  return {std::string(to_string(fault ? CommandResult::refused_fault : CommandResult::refused_not_ready)),
          fmt::format("cannot {}: not every drive is ready{}", to_string(kind), joints),
          std::string(next.empty() ? kTryAgain : next)};
}

// Names the joints. None: it has been homed since.
Refusal refused_not_homed(CommandKind kind, const wire::Telemetry& now, const wire::RobotInfo& info,
                          const robot::RobotConfig* robot) {
  std::string joints;
  for (std::size_t j = 0; j < std::min<std::size_t>(now.joint_count, wire::kNj); ++j) {
    const bool must = robot == nullptr || j >= robot->joints.size() || robot->joints[j].must_be_homed;
    if (!must || (now.joint_status[j] & wire::joint_status::kNotHomed) == 0) continue;
    joints += fmt::format("{}{}", joints.empty() ? ": joint " : ", ", joint_name(info, j));
  }
  return {
      std::string(to_string(CommandResult::refused_not_homed)),
      fmt::format("cannot {}: a joint with must_be_homed does not know in which turn it is{}", to_string(kind), joints),
      joints.empty() ? std::string(kTryAgain) : "home it, then: lithe arm"};
}

}  // namespace

std::optional<std::string> drives_told_in(std::string_view line) {
  constexpr std::string_view kFrom = "lithe-spine: ";
  if (!line.starts_with(kFrom)) return std::nullopt;
  line.remove_prefix(kFrom.size());
  if (line.starts_with("all buses and drives are well")) return "";
  const bool tells = line.starts_with("drive '") || line.starts_with("device '") || line.starts_with("bus '");
  return tells ? std::optional(std::string(line)) : std::nullopt;
}

Refusal refusal_of(CommandKind kind, CommandResult result, const wire::Telemetry& now, const wire::RobotInfo& info,
                   const DriveFacts& drives) {
  const std::string code(to_string(result));
  const auto mode = static_cast<wire::Mode>(now.mode);
  const auto fault = static_cast<wire::Fault>(now.fault);
  switch (result) {
    case CommandResult::refused_mode:
      return refused_by_mode(kind, mode, fault);
    case CommandResult::refused_estop:
      return refused_by_estop(kind);
    case CommandResult::refused_fault:
      return {code,
              fmt::format("cannot {}: fault {} is latched{}{}", to_string(kind), to_string(fault),
                          drives.told.empty() ? "" : "; now ", drives.told),
              way_to_active(mode, fault)};
    case CommandResult::refused_law:
      return refused_by_law(kind);
    case CommandResult::refused_range:
      return {code, "a parameter is outside its range or does not exist", "see the ranges: lithe param get"};
    case CommandResult::refused_not_ready:
      return refused_not_ready(kind, now, info, drives);
    case CommandResult::refused_not_homed:
      return refused_not_homed(kind, now, info, drives.robot);
    case CommandResult::refused_damaged:
      return {code, fmt::format("cannot {}: memory of the Spine that must not change has changed", to_string(kind)),
              kNewStart};
    case CommandResult::refused_outside:
      return refused_outside(kind, now, info);
    case CommandResult::refused_marked:
      return {code, "cannot arm: the law that would run has stopped the robot",
              "put another in: lithe activate LAW or lithe swap LAW, then: lithe arm; the same law all the same: "
              "lithe arm --all-the-same"};
    case CommandResult::refused_untried:
      return {code, "parameters in the Brain's mailbox are refused while a supervisor lives: it tries them first",
              "lithe param set, robot.params.set()"};
    case CommandResult::refused_not_simulated:
      return {code, "cannot put the joints back: the robot has a bus that is real",
              "bring them inside: lithe recover; only a robot whose buses are all of kind \"loop\" can be reset"};
    default:
      return {code, fmt::format("the Spine does not know the command {}", to_string(kind)),
              "build both from the same source"};
  }
}

std::variant<wire::Command, Refusal> params_command(const Json& values, const wire::LawInfo& law) {
  wire::Command command;
  command.kind = static_cast<std::uint32_t>(CommandKind::set_params);
  command.law_id = law.law_id;
  for (const auto& [name, value] : values.items()) {
    std::uint32_t index = 0;
    std::string known;
    while (index < law.param_count && name_at(law.param_name, index) != name) {
      known += (known.empty() ? "" : ", ") + name_at(law.param_name, index);
      ++index;
    }
    if (index == law.param_count) {
      return Refusal{"unknown_param", fmt::format("law '{}' has no parameter '{}'", text_of(law.name), name),
                     known.empty() ? "it has none" : fmt::format("it has: {}", known)};
    }
    if (!value.is_number() || !(value >= law.param_min[index]) || !(value <= law.param_max[index])) {
      return Refusal{
          "refused_range",
          fmt::format("{} = {} is outside [{}, {}]", name, value.dump(), law.param_min[index], law.param_max[index]),
          "nothing was changed; choose a value inside the range"};
    }
    command.index[command.count] = index;
    command.value[command.count] = value.get<double>();
    ++command.count;
  }
  if (command.count == 0) return Refusal{"usage", "no parameter was given", "lithe param set NAME VALUE"};
  return command;
}

std::uint64_t Commands::send(wire::Command command, Callback callback, std::int64_t now_ns) {
  const auto kind = static_cast<CommandKind>(command.kind);
  const bool stops = kind == CommandKind::disarm || kind == CommandKind::estop;
  if (closed_ && !stops) {
    callback(*closed_);
    return 0;
  }
  command.request_id = next_id_++;
  if (stops) newest_stop_ = command.request_id;
  const auto ticket = spine_.send(command);
  if (!ticket) {
    callback(Refusal{"busy", "the Spine has sixteen unread commands", "try again; if it stays so, lithe status"});
    return 0;
  }
  pending_.push_back({command, *ticket, now_ns, 0, std::move(callback), moving()});
  return command.request_id;
}

void Commands::refuse_all(const Refusal& reason) {
  for (; !pending_.empty(); pending_.pop_front()) pending_.front().callback(reason);
}

void Commands::serve(std::int64_t now_ns) {
  const wire::Telemetry now = spine_.now();
  // Answers may come out of order, and a callback may send a new command; so each pending command is checked once per
  // turn.
  for (std::size_t left = pending_.size(); left > 0; --left) {
    Pending each = std::move(pending_.front());
    pending_.pop_front();
    const auto kind = static_cast<CommandKind>(each.command.kind);
    const CommandResult result = spine_.poll(each.ticket);
    const bool in_time = now_ns - each.sent_ns < kTimeoutNs;
    const bool again = kind == CommandKind::arm && result == CommandResult::refused_not_ready &&
                       now_ns - each.sent_ns < kArmAgainNs && newest_stop_ < each.command.request_id;
    if (const auto ticket = again ? spine_.send(each.command) : std::nullopt) {
      each.ticket = *ticket;
      pending_.push_back(std::move(each));
    } else if (result == CommandResult::pending && in_time) {
      pending_.push_back(std::move(each));
    } else if (result == CommandResult::pending) {
      each.callback(
          Refusal{"timeout",
                  fmt::format("{} is not confirmed: no answer within 2 s; it may still take effect", to_string(kind)),
                  "see what the robot does: lithe status"});
    } else if (result != CommandResult::done) {
      Refusal refusal = refusal_of(kind, result, now, spine_.info(), drives_ ? drives_() : DriveFacts{});
      if (result == CommandResult::refused_estop)
        if (const std::string holder = spine_.estop_holder(); !holder.empty())
          refusal.message += fmt::format(", and held by the Brain, {}", holder);
      each.callback(refusal);
    } else if (each.seen_at_tick == 0) {
      each.seen_at_tick = now.tick + 1;  // the tick that handled the command publishes its record after its answer
      pending_.push_back(std::move(each));
    } else if (now.tick < each.seen_at_tick && in_time) {
      pending_.push_back(std::move(each));
    } else if (switches_off(kind) && static_cast<wire::Mode>(now.mode) == wire::Mode::safe_stop &&
               now_ns - each.sent_ns < kBrakingNs) {
      pending_.push_back(std::move(each));
    } else if (has_stopped(kind, now)) {
      each.callback(stopped_at_once(kind, now, spine_.info(), drives_ ? drives_() : DriveFacts{}));
    } else if (kind == CommandKind::arm && !all_driven(now) && now_ns - each.sent_ns < kDrivenNs) {
      pending_.push_back(std::move(each));
    } else {
      each.callback(result_json(each, now, now_ns));
    }
  }
}

}  // namespace lithe::control
