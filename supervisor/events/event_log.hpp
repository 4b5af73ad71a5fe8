// SPDX-License-Identifier: Apache-2.0
// The event log: the Spine's events and the supervisor's own, in order.
#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <string>
#include <string_view>

#include "spine/wire/wire.hpp"
#include "supervisor/core/answer.hpp"
#include "supervisor/link/spine/spine_link.hpp"

namespace lithe::control {

// An event of the Spine as text.
Json event_json(const wire::Event& event);
// With what the event has no field for: of a stop, a law's fault, a rollback or a revert "joint", "value" and "limit",
// as far as its text has them, and what to do ("next"); after the last two which law runs ("law"), and which joint of a
// refused plan is beyond which limit.
Json event_json(const wire::Event& event, const SpineLink& spine);
// What to do about the reason of a stop, a fault, a rollback or a revert, which is the first word of the Spine's event;
// empty: somebody asked for it.
std::string_view next_step(std::string_view why);
// One line for a person.
std::string event_line(const Json& event);

// Contract: one thread · keeps the last kDepth events; a reader with an old cursor learns how many it lost.
class EventLog {
 public:
  static constexpr std::size_t kDepth = 4096;

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

 private:
  std::deque<Json> events_;
  std::uint64_t last_ = 0;
  Json last_stop_ = nullptr;
  std::uint64_t lost_in_ring_ = 0;
};

}  // namespace lithe::control
