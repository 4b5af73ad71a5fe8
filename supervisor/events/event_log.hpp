// SPDX-License-Identifier: Apache-2.0
// The event log: the Spine's events and the supervisor's own, in order.
#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <limits>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "spine/wire/wire.hpp"
#include "supervisor/core/answer.hpp"
#include "supervisor/link/spine/spine_link.hpp"

namespace lithe::control {

// An event of the Spine as text.
Json event_json(const wire::Event& event);
// With what the event has no field for: of a stop, a law's fault, a rollback, a revert or a refused plan "joint",
// "value" and "limit", as far as its text has them; of all but the last what to do ("next"); after a rollback or revert
// which law runs ("law").
Json event_json(const wire::Event& event, const SpineLink& spine);
// What to do about the reason of a stop, a fault, a rollback or a revert, which is the first word of the Spine's event;
// empty: somebody asked for it.
std::string_view next_step(std::string_view why);
// What to do about a law that has stopped the robot: the law before it, or the same one all the same.
std::string way_from(std::uint32_t marked_id, const SpineLink& spine);
// One line for a person.
std::string event_line(const Json& event);

// Contract: one thread · keeps the last kDepth events; a reader with an old cursor learns how many it lost.
class EventLog {
 public:
  static constexpr std::size_t kDepth = 4096;

  // Where a joint's motion caused a stop or a rollback, its "next" names the computer, too, if that stood still before.
  void add(Json event);
  // An event of the supervisor itself, about a swap; also in the log file.
  void note(std::uint64_t request_id, const char* kind, const std::string& text);
  // Number of Spine events that were overwritten before they were read, since the start.
  void set_lost(std::uint64_t count) { lost_in_ring_ = count; }

  // {"events":[{"cursor":n, ...}], "cursor":last, "lost":n}: at most `limit` events after `since`, oldest first.
  Json since(std::uint64_t since, std::size_t limit) const;
  std::uint64_t last() const { return last_; }
  // The event of the newest stop, until the reset or recovery after it; null: none.
  const Json& last_stop() const { return last_stop_; }
  // The newest event law_suspected; null: none. It holds while telemetry has the flag of that name.
  const Json& last_suspicion() const { return last_suspicion_; }

 private:
  std::deque<Json> events_;
  std::uint64_t last_ = 0;
  Json last_stop_ = nullptr, last_suspicion_ = nullptr;
  std::uint64_t lost_in_ring_ = 0;
  std::int64_t last_stall_ns_ = std::numeric_limits<std::int64_t>::min() / 2;  // the newest that is known
};

// Passes every event of the other kinds. Of a frequent kind it passes the first event of each second, and then one
// summary with the number of the rest.
// Contract: one thread · the clock is an argument.
class NoiseFilter {
 public:
  static constexpr std::int64_t kWindowNs = 1'000'000'000;

  struct Summary {
    wire::EventKind kind;
    std::uint64_t count;
    wire::Event last;
  };

  bool passes(const wire::Event& event, std::int64_t now_ns) {
    const auto kind = static_cast<wire::EventKind>(event.kind);
    if (!is_frequent(kind, event.code)) return true;
    Window& window = windows_[kind];
    if (window.open) {
      ++window.held_back;
      window.last = event;
      return false;
    }
    window = {true, now_ns, 0, event};
    return true;
  }

  // Summaries of the windows that have ended since the last call and in which events were held back.
  std::vector<Summary> summaries(std::int64_t now_ns) {
    std::vector<Summary> out;
    for (auto& [kind, window] : windows_) {
      if (window.open && now_ns - window.since_ns >= kWindowNs) {
        window.open = false;
        if (window.held_back > 0) out.push_back({kind, window.held_back, window.last});
      }
    }
    return out;
  }

 private:
  struct Window {
    bool open = false;
    std::int64_t since_ns = 0;
    std::uint64_t held_back = 0;
    wire::Event last{};
  };

  static bool is_frequent(wire::EventKind kind, std::uint32_t code) {
    const bool not_ready = code == static_cast<std::uint32_t>(wire::CommandResult::refused_not_ready);
    return kind == wire::EventKind::deadline_missed || kind == wire::EventKind::sample_late ||
           kind == wire::EventKind::plan_refused || (kind == wire::EventKind::command_refused && not_ready);
  }

  std::map<wire::EventKind, Window> windows_;
};

}  // namespace lithe::control
