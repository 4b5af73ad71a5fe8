// SPDX-License-Identifier: Apache-2.0
#include "supervisor/events/event_log.hpp"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cstdlib>
#include <iterator>
#include <utility>

#include "spine/core/time.hpp"
#include "supervisor/link/spine/commands.hpp"

namespace lithe::control {
namespace {

// The meaning of an event's code depends on its kind. Empty when there is no name for it.
std::string code_word(wire::EventKind kind, std::uint32_t code) {
  switch (kind) {
    case wire::EventKind::fault:
    case wire::EventKind::safe_stop:
    case wire::EventKind::group_stopped:
      return std::string(to_string(static_cast<wire::Fault>(code)));
    case wire::EventKind::command_refused:
    case wire::EventKind::params_refused:
      return std::string(to_string(static_cast<wire::CommandResult>(code)));
    case wire::EventKind::law_refused:
      return std::string(to_string(static_cast<wire::StageResult>(code)));
    case wire::EventKind::plan_refused:
      return std::string(to_string(static_cast<wire::PlanReject>(code)));
    case wire::EventKind::law_suspected:
      return std::string(to_string(static_cast<wire::LawFaultKind>(code)));
    default:
      return {};
  }
}

// It stops the robot, takes its law or parameters away, or may come to that.
bool tells_next(wire::EventKind kind) {
  constexpr wire::EventKind kKinds[] = {wire::EventKind::law_rolled_back, wire::EventKind::params_reverted,
                                        wire::EventKind::law_faulted,     wire::EventKind::safe_stop,
                                        wire::EventKind::group_stopped,   wire::EventKind::memory_damaged,
                                        wire::EventKind::law_marked,      wire::EventKind::law_suspected};
  return std::ranges::find(kKinds, kind) != std::end(kKinds);
}

// "joint wrist: 19.3 rad/s" -> wrist. Names may begin alike, so the longest counts; empty: there is none.
std::string joint_in(std::string_view text, const wire::RobotInfo& info) {
  std::string longest;
  for (std::size_t j = 0; j < std::min<std::size_t>(info.joint_count, wire::kNj); ++j) {
    const std::string name = joint_name(info, j), words = "joint " + name;
    const std::size_t at = text.find(words), end = at + words.size();
    const bool whole = at != std::string_view::npos && (end == text.size() || text.find_first_of(":, ", end) == end);
    if (whole && name.size() > longest.size()) longest = name;
  }
  return longest;
}

// What the sentence of a stop or a fault has: "velocity_limit at joint wrist: 19.3 rad/s, allowed 18.8" gives joint,
// value and limit, "allowed -2.5 to 2.5" the limit that was passed. Nothing from numbers that may have been cut off.
// Without a number in the text there is no value: the event's own means something else (steps of a rollback, the index
// of a joint).
void put_facts(std::string_view text, const wire::RobotInfo& info, Json& out) {
  constexpr std::string_view kAllowed = ", allowed ", kDigits = "0123456789", kNumber = "0123456789.-", kTo = " to ";
  out.erase("value");
  if (const std::string joint = joint_in(text, info); !joint.empty()) out["joint"] = joint;
  const std::size_t allowed = text.find(kAllowed);
  if (allowed == std::string_view::npos || text.size() + 1 >= sizeof(wire::Event::text)) return;
  const std::string_view before = text.substr(0, allowed);
  const std::size_t last = before.find_last_of(kDigits);
  if (last == std::string_view::npos) return;
  const std::size_t first = before.find_last_not_of(kNumber, last) + 1;  // 0 where there is no other letter
  const double value = std::strtod(std::string(before.substr(first)).c_str(), nullptr);
  const std::string limits(text.substr(allowed + kAllowed.size()));
  char* rest = nullptr;
  double limit = std::strtod(limits.c_str(), &rest);
  if (std::string_view(rest).starts_with(kTo) && value > limit) limit = std::strtod(rest + kTo.size(), nullptr);
  out["value"] = value;
  out["limit"] = limit;
}

// While the computer stands still a robot moves otherwise than its law wants. Then less gain does not help.
constexpr std::int64_t kStallBeforeNs = 2'000'000'000;
constexpr std::int64_t kStallTicks = 5;  // skipped in a row: fewer come within any 2 s of a busy computer
constexpr std::string_view kStallBefore =
    "; within the 2 s before, the computer stood still for several ticks: if that was the cause, lithe doctor";

bool is_of_motion(std::string_view why) {
  constexpr std::string_view kReasons[] = {"tracking_lost", "guard_busy",     "guard_stopped",  "chattering",
                                           "oscillating",   "position_limit", "velocity_limit", "pushes_away"};
  return std::ranges::find(kReasons, why.substr(0, why.find_first_of(":; "))) != std::end(kReasons);
}

}  // namespace

std::string_view next_step(std::string_view why) {
  constexpr std::pair<std::string_view, std::string_view> kSteps[] = {
      {"tracking_lost", "make the law follow its setpoint better: look at the signs, sizes and units of its gains"},
      {"pushes_away", "look for a sign that changes, or an integral that winds up, and when; lithe law show --source"},
      {"gives_no_torque", "look for what takes its torque away: a gain that fades, a time, a State; lithe law show"},
      {"guard_busy", "command less at this joint, or plan it slower; the robot file has its limits"},
      {"guard_stopped", "slow the joint down before its limits; the robot goes on after: lithe reset, lithe arm"},
      {"chattering", "lower the joint's damping, or smooth the speed that it uses"},
      {"oscillating", "lower the joint's stiffness or raise its damping; swings of 35 Hz and more: lower its damping"},
      {"overran", "make its step shorter (swap.budget_share); where the computer stood still, swap it in again"},
      {"not_finite", "look for a division by 0, or an input that is NaN (std::isnan)"},
      {"law_not_finite", "look for a division by 0, or an input that is NaN (std::isnan); on again: lithe reset"},
      {"bad_access", "keep every array index below t.joints; lithe law show names the line"},
      {"bus_error", "keep every array index below t.joints; lithe law show names the line"},
      {"state_broken", "keep every array index below t.joints; lithe law show names the line"},
      {"arithmetic", "an integer was divided by 0: test the divisor first; lithe law show names the line"},
      {"illegal_instruction", "let every path of a function return; lithe law show names the line"},
      {"trapped", "let every path of a function return; lithe law show names the line"},
      {"aborted", "take out what ends the program (assert, an exception); lithe law show names the line"},
      {"system_call", "take it out: a law computes only; lithe law show names the line"},
      {"position_limit", "slow the joint down before its limits; on again: lithe recover, lithe arm"},
      {"velocity_limit", "plan slower, or give the law less gain and more damping; on again: lithe reset, lithe arm"},
      {"sample_stale", "find what is late: lithe bus monitor, lithe doctor; on again: lithe reset, lithe arm"},
      {"drive_fault", "clear what the drive reports (lithe status); on again: lithe reset, lithe arm"},
      {"drive_watchdog", "find what held the commands up: lithe bus monitor, lithe doctor; on again: lithe reset"},
      {"drive_lost", "check its power, cable and id: lithe bus scan; on again: lithe reset, lithe arm"},
      {"drive_conflict", "give the two devices different ids: lithe bus scan; on again: lithe reset, lithe arm"},
      {"drive_garbled", "check the cable, the device and its firmware: lithe bus monitor; on again: lithe reset"},
      {"drive_not_homed", "home the joint again; then: lithe reset, lithe arm"},
      {"recover_failed", "take the load away, or raise guard.recover_torque_share; then: lithe recover"},
      {"deadline_missed", "find what disturbs the Spine's core: lithe doctor; on again: lithe reset, lithe arm"},
      {"brain_stale", "start the Brain, or let it send heartbeats more often; on again: lithe reset, lithe arm"},
      {"plan_torn", "let one thread publish, and only plans that are complete; on again: lithe reset, lithe arm"},
      {"memory_damaged", "swap the law that ran for another; only a new process helps: lithe stop, lithe run"}};
  const auto found = std::ranges::find_if(
      kSteps, [why](const auto& each) { return why.substr(0, why.find_first_of(":; ")) == each.first; });
  return found == std::end(kSteps) ? std::string_view() : found->second;
}

Json event_json(const wire::Event& event) {
  const auto kind = static_cast<wire::EventKind>(event.kind);
  Json out = {{"t_ns", event.t_ns}, {"tick", event.tick}, {"kind", std::string(to_string(kind))}};
  const std::string word = code_word(kind, event.code);
  if (!word.empty()) out["reason"] = word;
  out["code"] = event.code;
  out["value"] = event.value;
  out["request_id"] = event.request_id;
  out["text"] = text_of(event.text);
  return out;
}

std::string way_from(std::uint32_t marked_id, const SpineLink& spine) {
  const auto marked = spine.law(marked_id);
  std::string good;  // the newest one before it
  for (const wire::LawInfo& law : spine.laws())
    if (law.law_id < marked_id) good = text_of(law.name);
  const std::string name = marked ? text_of(marked->name) : "its law";
  return fmt::format("{} stopped the robot; on again without it: {}, lithe reset, lithe arm; with it: {}", name,
                     good.empty() ? "lithe swap hold" : "lithe activate " + good, "lithe arm --all-the-same");
}

Json event_json(const wire::Event& event, const SpineLink& spine) {
  Json out = event_json(event);
  std::string more;
  const auto kind = static_cast<wire::EventKind>(event.kind);
  if (kind == wire::EventKind::law_rolled_back || kind == wire::EventKind::params_reverted) {
    const auto law = spine.law(event.code);
    out["law"] = law ? Json(text_of(law->name)) : Json(nullptr);
    more = law ? fmt::format("law {} runs now", text_of(law->name)) : "no law runs now";
  }
  const std::string text = out["text"];
  if (tells_next(kind) || kind == wire::EventKind::plan_refused) put_facts(text, spine.info(), out);
  const bool is_outside = kind == wire::EventKind::law_suspected && out["reason"] == "tracking_lost";
  const std::string_view next =
      is_outside ? "look for a load, an obstacle, a drive with less torque, or a plan too fast for the law"
                 : next_step(text);
  if (tells_next(kind) && !next.empty()) out["next"] = std::string(next);
  if (kind == wire::EventKind::law_marked) {
    const std::string cause = out.value("next", "");
    out["next"] =
        (cause.empty() ? "" : cause.substr(0, cause.find("; the robot goes on")) + "; ") + way_from(event.code, spine);
  }
  if (!more.empty()) out["text"] = text.empty() ? more : text + "; " + more;
  return out;
}

std::string event_line(const Json& event) {
  std::string line = event.value("kind", "?");
  if (event.contains("reason")) line += fmt::format(" ({})", event["reason"].get<std::string>());
  if (const std::string text = event.value("text", ""); !text.empty()) line += ": " + text;
  if (const std::string next = event.value("next", ""); !next.empty()) line += "; next: " + next;
  if (const std::uint64_t tick = event.value("tick", std::uint64_t{0}); tick != 0)
    line += fmt::format(" [tick {}]", tick);
  return line;
}

void EventLog::add(Json event) {
  const std::string kind = event.value("kind", "");
  const auto t_ns = event.value("t_ns", std::int64_t{0});
  if (kind == "deadline_missed" && event.value("code", std::int64_t{0}) >= kStallTicks) last_stall_ns_ = t_ns;
  if (event.contains("next") && is_of_motion(event.value("text", "")) && t_ns - last_stall_ns_ < kStallBeforeNs)
    event["next"] = event["next"].get<std::string>() + std::string(kStallBefore);
  Json numbered = {{"cursor", ++last_}};
  numbered.update(event);
  if (kind == "safe_stop" || kind == "group_stopped") last_stop_ = event;
  if (kind == "law_marked" && last_stop_.is_object()) last_stop_["next"] = event["next"];
  if (kind == "law_suspected") last_suspicion_ = event;
  if (kind == "reset" || kind == "recovering") last_stop_ = nullptr;
  events_.push_back(std::move(numbered));
  if (events_.size() > kDepth) events_.pop_front();
}

void EventLog::note(std::uint64_t request_id, const char* kind, const std::string& text) {
  add({{"t_ns", monotonic_ns()}, {"tick", 0}, {"kind", kind}, {"request_id", request_id}, {"text", text}});
  spdlog::info("{}: {}", kind, text);
}

Json EventLog::since(std::uint64_t since, std::size_t limit) const {
  const std::uint64_t oldest = last_ - events_.size() + 1;
  const std::uint64_t begin = std::max(std::min(since, last_) + 1, oldest);
  const std::uint64_t missed = since + 1 < oldest ? oldest - since - 1 : 0;
  Json list = Json::array();
  std::uint64_t cursor = begin - 1;
  while (cursor < last_ && list.size() < limit) list.push_back(events_[static_cast<std::size_t>(++cursor - oldest)]);
  return {{"events", std::move(list)}, {"cursor", cursor}, {"lost", missed + lost_in_ring_}};
}

}  // namespace lithe::control
