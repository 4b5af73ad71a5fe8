// SPDX-License-Identifier: Apache-2.0
// The tick's outputs: one telemetry record, histogram counts, and events.
#pragma once

#include <cstdint>
#include <string_view>

#include "spine/core/histogram.hpp"
#include "spine/core/rt.hpp"
#include "spine/ipc/layout.hpp"
#include "spine/law/resident.hpp"
#include "spine/step/laws.hpp"
#include "spine/step/report.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::loop {

// The durations of one tick [ns].
struct Durations {
  std::int64_t release_jitter_ns = 0;  // woken minus due
  // From the start of the tick until u_k is handed over; inline Transport: from the start of the previous tick until
  // its exchange began.
  std::int64_t handoff_ns = 0;
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

  // Publishes an event of the loop itself.
  void event(wire::EventKind kind, std::int64_t now_ns, std::uint32_t code, double value, std::string_view text)
      LITHE_RT;
  // All events of a step, and its answer to a plan.
  void tell(const step::Report& report, const step::Laws& laws) LITHE_RT;
  // Its State, bounded by kMaxStateBytes; only the words in use are written.
  void state(const law::Resident& law) LITHE_RT;

  void heartbeat(std::int64_t now_ns) LITHE_RT;

 private:
  void params(const law::Resident& law) LITHE_RT;

  using Histogram = HistogramWriter<wire::Histogram>;
  wire::SegmentHeader* header_;
  ipc::RingWriter<wire::Telemetry, wire::spine_segment::kTelemetryDepth> telemetry_;
  ipc::RingWriter<wire::Event, wire::spine_segment::kEventsTickDepth> events_;
  ipc::ChannelWriter<wire::Params> params_;
  ipc::RingWriter<wire::LawFault, wire::spine_segment::kLawFaultsDepth> law_faults_;
  ipc::RingWriter<wire::PlanDecision, wire::spine_segment::kPlanDecisionsDepth> plan_decisions_;
  ipc::ChannelWriter<wire::ShadowReport> shadow_;
  ipc::ChannelWriter<wire::LawState> law_state_;
  Histogram release_jitter_, handoff_, law_, guard_, tick_, bus_;
  wire::WordRanges used_;  // of a telemetry record, for this many joints
  wire::Telemetry record_{};
  wire::Params param_values_{};
  wire::LawState state_{};
};

}  // namespace lithe::loop
