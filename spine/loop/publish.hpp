// SPDX-License-Identifier: Apache-2.0
// The tick's outputs: one telemetry record, histogram counts, and events.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "spine/core/histogram.hpp"
#include "spine/core/rt.hpp"
#include "spine/ipc/layout.hpp"
#include "spine/law/resident.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::loop {

// Text of an event, composed in the tick; text that does not fit is cut.
// Contract: RT · a value
class Words {
 public:
  Words& operator<<(std::string_view more) LITHE_RT {
    const std::size_t fits = std::min(more.size(), letters_.size() - size_);
    std::copy_n(more.begin(), fits, letters_.begin() + size_);
    size_ += fits;
    return *this;
  }
  // A number with this many decimals, at most 6; clamped to +-1e9.
  Words& number(double value, int decimals) LITHE_RT {
    decimals = std::min(decimals, 6);
    double scale = 1;
    for (int i = 0; i < decimals; ++i) scale *= 10;
    const double size = value < 0 ? -value : value;
    auto left = static_cast<std::uint64_t>((size < 1e9 ? size : 1e9) * scale + 0.5);  // NaN: 1e9
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

// The durations of one tick [ns].
struct Durations {
  std::int64_t release_jitter_ns = 0;  // woken minus due
  std::int64_t handoff_ns =
      0;  // woken to u_k handed over; inline Transport: of the previous tick, until the bus was served
  std::int64_t law_ns = 0;
  std::int64_t guard_ns = 0;
  std::int64_t tick_ns = 0;  // of the previous tick: this one is not over when it is published
  std::int64_t bus_ns = 0;
};

// Contract: RT · owned by the tick thread · independent of readers
class Publisher {
 public:
  Publisher(ipc::SpineMemory& memory, std::uint32_t joints);

  // The record of this tick, to be filled in place; joint_count is set, and entries beyond it stay zero.
  wire::Telemetry& record() LITHE_RT { return record_; }

  // Counts the skipped releases before this one: each was late by the time until this tick began.
  void skipped(std::uint32_t count, std::int64_t release_jitter_ns, std::int64_t period_ns) LITHE_RT;

  // Publishes record() and counts the durations.
  void publish(const Durations& durations, bool fresh_sample) LITHE_RT;

  void event(wire::EventKind kind, std::int64_t now_ns, std::uint32_t code, std::uint64_t request_id, double value,
             std::string_view text) LITHE_RT;

  void params(const law::Resident& law) LITHE_RT;
  // Its State, bounded by kMaxStateBytes; only the words in use are written.
  void state(const law::Resident& law) LITHE_RT;
  void law_fault(const wire::LawFault& fault) LITHE_RT { law_faults_.push(fault); }
  void shadow(const wire::ShadowReport& report) LITHE_RT { shadow_.write(report); }

  void beat(std::int64_t now_ns) LITHE_RT;

 private:
  using Histogram = HistogramWriter<wire::Histogram>;
  wire::SegmentHeader* header_;
  ipc::RingWriter<wire::Telemetry, wire::spine_segment::kTelemetryDepth> telemetry_;
  ipc::RingWriter<wire::Event, wire::spine_segment::kEventsTickDepth> events_;
  ipc::ChannelWriter<wire::Params> params_;
  ipc::RingWriter<wire::LawFault, wire::spine_segment::kLawFaultsDepth> law_faults_;
  ipc::ChannelWriter<wire::ShadowReport> shadow_;
  ipc::ChannelWriter<wire::LawState> law_state_;
  Histogram release_jitter_, handoff_, law_, guard_, tick_, bus_;
  wire::WordRanges used_;  // of a telemetry record, for this many joints
  wire::Telemetry record_{};
  wire::Event event_{};
  wire::Params param_values_{};
  wire::LawState state_{};
};

}  // namespace lithe::loop
