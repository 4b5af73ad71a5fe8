// SPDX-License-Identifier: Apache-2.0
// What a step returns besides the command and the telemetry record: events, law faults, flags, durations.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>

#include "spine/core/rt.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::step {

// Text of an event, composed in the tick; text that does not fit is cut.
// Contract: RT · a value
class EventText {
 public:
  EventText& operator<<(std::string_view more) LITHE_RT {
    const std::size_t fits = std::min(more.size(), letters_.size() - size_);
    std::copy_n(more.begin(), fits, letters_.begin() + size_);
    size_ += fits;
    return *this;
  }
  // A number with this many decimals, at most 6; clamped to +-1e9; or nan, inf, -inf.
  EventText& number(double value, int decimals) LITHE_RT {
    if (std::isnan(value)) return *this << "nan";
    if (std::isinf(value)) return *this << (value < 0 ? "-inf" : "inf");
    decimals = std::min(decimals, 6);
    double scale = 1;
    for (int i = 0; i < decimals; ++i) scale *= 10;
    const double size = value < 0 ? -value : value;
    auto left = static_cast<std::uint64_t>((size < 1e9 ? size : 1e9) * scale + 0.5);
    char digits[24];
    std::size_t at = sizeof digits;
    for (int place = 0; at > 1 && (place <= decimals || left > 0); ++place) {
      if (place == decimals && decimals > 0) digits[--at] = '.';
      digits[--at] = static_cast<char>('0' + left % 10);
      left /= 10;
    }
    return *this << (value < 0 ? "-" : "") << std::string_view(digits + at, sizeof digits - at);
  }
  std::string_view text() const LITHE_RT { return {letters_.data(), size_}; }

 private:
  std::array<char, sizeof(wire::Event::text)> letters_{};
  std::size_t size_ = 0;
};

inline std::uint32_t clamp_ns(std::int64_t duration_ns) LITHE_RT {
  return static_cast<std::uint32_t>(std::clamp<std::int64_t>(duration_ns, 0, UINT32_MAX));
}

inline wire::Event make_event(wire::EventKind kind, std::uint64_t tick, std::int64_t now_ns, std::uint32_t code,
                              std::uint64_t request_id, double value, std::string_view text) LITHE_RT {
  wire::Event event;
  event.t_ns = now_ns;
  event.tick = tick;
  event.request_id = request_id;
  event.kind = static_cast<std::uint32_t>(kind);
  event.code = code;
  event.value = value;
  const std::size_t fits = std::min(text.size(), event.text.size() - 1);  // substr() could throw
  std::copy_n(text.begin(), fits, event.text.begin());
  return event;
}

// Contract: RT · of one step, until the next one
class Report {
 public:
  void begin(std::uint64_t tick, std::int64_t now_ns) LITHE_RT {
    tick_ = tick;
    now_ns_ = now_ns;
    events_ = faults_ = flags = 0;
    law_ns = guard_ns = 0;
    params_changed = shadow_changed = plan_decided = false;
  }
  // One tick makes at most kMostEvents; further ones would be dropped.
  void event(wire::EventKind kind, std::uint32_t code, std::uint64_t request_id, double value, std::string_view text)
      LITHE_RT {
    if (events_ == kMostEvents) return;
    event_[events_++] = make_event(kind, tick_, now_ns_, code, request_id, value, text);
  }
  void law_fault(const wire::LawFault& fault) LITHE_RT {
    if (faults_ < fault_.size()) fault_[faults_++] = fault;
  }

  std::span<const wire::Event> events() const LITHE_RT { return {event_.data(), events_}; }
  std::span<const wire::LawFault> law_faults() const LITHE_RT { return {fault_.data(), faults_}; }
  std::uint64_t tick() const LITHE_RT { return tick_; }
  std::int64_t now_ns() const LITHE_RT { return now_ns_; }

  std::uint32_t flags = 0;                // bits of wire::telemetry_flag
  std::int64_t law_ns = 0, guard_ns = 0;  // measured
  bool params_changed = false;            // of the active law, or there is another one
  bool shadow_changed = false;            // the comparison of a candidate
  bool plan_decided = false;              // there was a plan: plan_decision is its answer
  wire::PlanDecision plan_decision;
  wire::CommandResult answer = wire::CommandResult::refused_unknown;  // to the command, if there was one

 private:
  static constexpr std::size_t kMostEvents = 64;
  std::uint64_t tick_ = 0;
  std::int64_t now_ns_ = 0;
  std::uint32_t events_ = 0, faults_ = 0;
  std::array<wire::Event, kMostEvents> event_{};
  std::array<wire::LawFault, 4> fault_{};
};

}  // namespace lithe::step
