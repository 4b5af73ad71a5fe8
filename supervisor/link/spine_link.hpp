// SPDX-License-Identifier: Apache-2.0
// The Spine as the supervisor sees it: shared memory to read, a mailbox to write, and nothing to wait for.
#pragma once

#include <sys/types.h>

#include <array>
#include <cstdint>
#include <cstring>
#include <optional>
#include <string>
#include <vector>

#include "spine/core/result.hpp"
#include "spine/core/text.hpp"
#include "spine/ipc/segment.hpp"
#include "supervisor/core/answer.hpp"

namespace lithe::control {

// Text of a fixed, zero-terminated field. Whatever stands there, the result stays inside the field and is printable: a
// wild write reaches shared memory, too.
template <std::size_t N>
std::string text_of(const std::array<char, N>& field, std::size_t offset = 0, std::size_t width = N) {
  return printable({field.data() + offset, ::strnlen(field.data() + offset, width)});
}

struct Quantiles {
  double p50_us, p99_us, p999_us, max_us;
  std::uint64_t count;
};

// The law that runs, and the values of its parameters now: name -> value, in the law's own order.
struct RunningLaw {
  wire::LawInfo info;
  swap::Json values = swap::Json::object();
};

// Who holds this robot's Spine lease at this moment; 0 where its pid cannot be read, nothing when nobody does.
std::optional<pid_t> spine_now(const std::string& robot);

// The live Spine of this robot: whoever holds its lease. Its pid comes from the segment's header, which is the same in
// every layout; 0 where that cannot be read. Nothing when no Spine lives. One that was just killed gets up to 5 s to
// end.
std::optional<pid_t> live_spine(const std::string& robot);

// Removes the segments, but never those of a live Spine, whoever started it: false when one holds them.
bool remove_segments(const std::string& robot);

// Sets the sticky e-stop word whoever holds the lease: an e-stop asks nobody. For use with and without a supervisor.
Result<> press_estop(const std::string& robot);

// Contract: one thread, one per robot (the caller holds the lease of the control segment) · never blocks.
class SpineLink {
 public:
  static Result<SpineLink> attach(const std::string& robot);

  pid_t spine_pid() const;
  const wire::RobotInfo& info() const { return info_; }

  bool latest(wire::Telemetry& out) const { return telemetry_.latest(out); }
  std::optional<wire::LawInfo> law(std::uint32_t law_id) const;
  std::vector<wire::LawInfo> laws() const;
  std::optional<wire::Params> params() const;
  std::optional<RunningLaw> running_law() const;
  Quantiles quantiles(const ipc::HistogramMemory& histogram) const;
  const ipc::SpineMemory& memory() const { return *spine_; }

  // The last word of a Spine that has ended: whether every drive was told that it is off. Nothing: it never said so.
  std::optional<bool> told_off() const;

  // Events since the last call, both rings merged by time.
  std::vector<wire::Event> drain_events();
  std::uint64_t lost_events() const { return events_tick_.lost() + events_loader_.lost(); }

  // A ticket, or nothing while the mailbox is full.
  std::optional<std::uint64_t> send(const wire::Command& command) { return commands_.send(command); }
  wire::CommandResult poll(std::uint64_t ticket) const {
    return static_cast<wire::CommandResult>(commands_.poll(ticket));
  }
  std::optional<std::uint64_t> stage(const wire::StageRequest& request) { return stage_.send(request); }
  // Of the newest request that this supervisor or one before it has sent; 0 = none.
  std::uint64_t last_stage_ticket() const { return stage_.last_ticket(); }
  wire::StageResult poll_stage(std::uint64_t ticket) const {
    return static_cast<wire::StageResult>(stage_.poll(ticket));
  }

  void heartbeat(std::int64_t now_ns);
  void press_estop();
  void release_estop();

 private:
  SpineLink(ipc::Segment<ipc::SpineMemory> spine, ipc::Segment<ipc::ControlMemory> control);

  ipc::Segment<ipc::SpineMemory> spine_;
  ipc::Segment<ipc::ControlMemory> control_;
  wire::RobotInfo info_{};
  ipc::RingReader<wire::Telemetry, wire::spine_segment::kTelemetryDepth> telemetry_;
  ipc::RingReader<wire::Event, wire::spine_segment::kEventsTickDepth> events_tick_;
  ipc::RingReader<wire::Event, wire::spine_segment::kEventsLoaderDepth> events_loader_;
  ipc::MailboxSender<wire::Command, wire::control_segment::kCommandsDepth> commands_;
  ipc::MailboxSender<wire::StageRequest, wire::control_segment::kStageDepth> stage_;
};

}  // namespace lithe::control
