// SPDX-License-Identifier: Apache-2.0
// Rate limit for events that can occur many times a second.
#pragma once

#include <cstdint>
#include <map>
#include <vector>

#include "spine/wire/wire.hpp"

namespace lithe::control {

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
