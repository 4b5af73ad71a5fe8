// SPDX-License-Identifier: Apache-2.0
// The three segments as C++ sees them. Every offset is asserted against the generated table.
#pragma once

#include <array>
#include <cstddef>

#include "spine/ipc/channel.hpp"
#include "spine/ipc/mailbox.hpp"
#include "spine/ipc/ring.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::ipc {

struct alignas(kLine) Header : wire::SegmentHeader {};

// One 64-bit word on a line of its own.
struct alignas(kLine) StickyWord {
  std::uint64_t value;
};

struct alignas(kLine) HistogramMemory : wire::Histogram {};
struct alignas(kLine) HealthMemory : wire::Health {};

using TelemetryRing = RingMemory<wire::Telemetry, wire::spine_segment::kTelemetryDepth>;
using EventRing = RingMemory<wire::Event, wire::spine_segment::kEventsTickDepth>;
using PlanDecisionRing = RingMemory<wire::PlanDecision, wire::spine_segment::kPlanDecisionsDepth>;
using CommandMailbox = MailboxMemory<wire::Command, wire::control_segment::kCommandsDepth>;
using CommandAck = AckMemory<wire::control_segment::kCommandsDepth>;
using StageMailbox = MailboxMemory<wire::StageRequest, wire::control_segment::kStageDepth>;
using StageAck = AckMemory<wire::control_segment::kStageDepth>;

struct SpineMemory {
  static constexpr const char* kName = "spine";
  Header header;
  ChannelMemory<wire::RobotInfo> robot_info;
  TelemetryRing telemetry;
  EventRing events_tick;
  EventRing events_loader;
  ChannelMemory<wire::Params> params;
  std::array<ChannelMemory<wire::LawInfo>, wire::kNlaw> law_info;
  RingMemory<wire::LawFault, wire::spine_segment::kLawFaultsDepth> law_faults;
  ChannelMemory<wire::ShadowReport> shadow;
  ChannelMemory<wire::LawState> law_state;
  HistogramMemory release_jitter, handoff, law, guard, tick, bus;
  CommandAck control_ack;
  CommandAck brain_ack;
  StageAck stage_ack;
  HealthMemory health;
  PlanDecisionRing plan_decisions;
};

struct ControlMemory {
  static constexpr const char* kName = "control";
  Header header;
  CommandMailbox commands;
  StageMailbox stage;
  StickyWord estop;
};

struct BrainMemory {
  static constexpr const char* kName = "brain";
  Header header;
  ChannelMemory<wire::Plan> plan;
  CommandMailbox commands;
  StickyWord estop;
  ChannelMemory<wire::Inputs> inputs;
};

static_assert(offsetof(SpineMemory, robot_info) == wire::spine_segment::kRobotInfoOffset);
static_assert(offsetof(SpineMemory, telemetry) == wire::spine_segment::kTelemetryOffset);
static_assert(offsetof(SpineMemory, events_tick) == wire::spine_segment::kEventsTickOffset);
static_assert(offsetof(SpineMemory, events_loader) == wire::spine_segment::kEventsLoaderOffset);
static_assert(offsetof(SpineMemory, params) == wire::spine_segment::kParamsOffset);
static_assert(offsetof(SpineMemory, law_info) == wire::spine_segment::kLawInfoOffset);
static_assert(sizeof(ChannelMemory<wire::LawInfo>) == wire::spine_segment::kLawInfoStride);
static_assert(offsetof(SpineMemory, law_state) == wire::spine_segment::kLawStateOffset);
static_assert(offsetof(SpineMemory, release_jitter) == wire::spine_segment::kReleaseJitterOffset);
static_assert(offsetof(SpineMemory, bus) == wire::spine_segment::kBusOffset);
static_assert(offsetof(SpineMemory, control_ack) == wire::spine_segment::kControlAckOffset);
static_assert(offsetof(SpineMemory, brain_ack) == wire::spine_segment::kBrainAckOffset);
static_assert(offsetof(SpineMemory, stage_ack) == wire::spine_segment::kStageAckOffset);
static_assert(offsetof(SpineMemory, health) == wire::spine_segment::kHealthOffset);
static_assert(sizeof(SpineMemory) == wire::spine_segment::kBytes);
static_assert(offsetof(ControlMemory, commands) == wire::control_segment::kCommandsOffset);
static_assert(offsetof(ControlMemory, stage) == wire::control_segment::kStageOffset);
static_assert(offsetof(ControlMemory, estop) == wire::control_segment::kEstopOffset);
static_assert(sizeof(ControlMemory) == wire::control_segment::kBytes);
static_assert(offsetof(BrainMemory, plan) == wire::brain_segment::kPlanOffset);
static_assert(offsetof(BrainMemory, commands) == wire::brain_segment::kCommandsOffset);
static_assert(offsetof(BrainMemory, estop) == wire::brain_segment::kEstopOffset);
static_assert(offsetof(BrainMemory, inputs) == wire::brain_segment::kInputsOffset);
static_assert(sizeof(BrainMemory) == wire::brain_segment::kBytes);

}  // namespace lithe::ipc
