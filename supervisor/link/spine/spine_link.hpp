// SPDX-License-Identifier: Apache-2.0
// The supervisor's access to the Spine: reads shared memory, writes the mailbox, never waits.
#pragma once

#include <sys/types.h>

#include <array>
#include <cstdint>
#include <cstring>
#include <optional>
#include <string>
#include <vector>

#include "spine/arena/layout.hpp"
#include "spine/core/host/fd.hpp"
#include "spine/core/result.hpp"
#include "spine/core/text.hpp"
#include "spine/ipc/segment.hpp"
#include "spine/robot/config.hpp"
#include "supervisor/core/answer.hpp"

namespace lithe::control {

// Text of a fixed, zero-terminated field. For any bytes the result stays inside the field and is printable: a stray
// write of a law can damage shared memory.
template <std::size_t N>
std::string text_of(const std::array<char, N>& field, std::size_t offset = 0, std::size_t width = N) {
  return printable({field.data() + offset, ::strnlen(field.data() + offset, width)});
}

// Entry `i` of a field that holds names one behind the other.
template <std::size_t N>
std::string name_at(const std::array<char, N>& names, std::size_t i) {
  constexpr std::size_t kWidth = 32;
  return text_of(names, i * kWidth, kWidth);
}
inline std::string joint_name(const wire::RobotInfo& info, std::size_t joint) {
  return name_at(info.joint_name, joint);
}

struct Quantiles {
  double p50_us, p99_us, p999_us, max_us;
  std::uint64_t count;
};

// The law that runs, and the values of its parameters now: name -> value, in the law's own order.
struct RunningLaw {
  wire::LawInfo info;
  Json values = Json::object();
};

// Pid of the holder of this robot's Spine lease; 0 when the pid cannot be read, empty when the lease is free.
std::optional<pid_t> spine_now(const std::string& robot);

// Pid of the live Spine of this robot: the holder of its lease. It is read from the segment's header, which is the same
// in every layout; 0 when it cannot be read. Empty when no Spine lives. Waits up to 5 s for a Spine that was just
// killed.
std::optional<pid_t> live_spine(const std::string& robot);

// Pid of the supervisor, from its pid file, else from its shared memory; 0 = unknown. For one that does not listen.
pid_t noted_supervisor(const std::string& robot);

// The code arena of this robot: that of a live Spine, else a new one. Empty, with a warning in the log, when laws must
// be loaded with dlopen.
Fd open_arena(const robot::RobotConfig& robot);

// Removes the segments. Returns false and removes nothing while a live Spine holds them.
bool remove_segments(const std::string& robot);

// Sets the sticky e-stop word without checking the lease. Works with and without a supervisor.
Result<> press_estop(const std::string& robot);

// Contract: one thread, one per robot (the caller holds the lease of the control segment) · never blocks.
class SpineLink {
 public:
  static Result<SpineLink> attach(const std::string& robot);

  pid_t spine_pid() const;
  const wire::RobotInfo& info() const { return info_; }

  bool latest(wire::Telemetry& out) const { return telemetry_.latest(out); }
  wire::Telemetry now() const;  // the same; all zero before the first tick
  std::optional<wire::LawInfo> law(std::uint32_t law_id) const;
  std::vector<wire::LawInfo> laws() const;
  std::optional<wire::Params> params() const;
  std::optional<RunningLaw> running_law() const;
  // The Brain's last heartbeat, by the clock of the Brain; 0 before the first.
  std::int64_t brain_heartbeat_ns() const;
  Quantiles quantiles(const ipc::HistogramMemory& histogram) const;
  const ipc::SpineMemory& memory() const { return *spine_; }

  // The final report of a Spine that has ended: whether every drive was commanded off. Empty when there is no report.
  std::optional<bool> confirmed_off() const;

  // Events since the last call, both rings merged by time.
  std::vector<wire::Event> drain_events();
  std::uint64_t lost_events() const { return events_tick_.lost() + events_loader_.lost(); }

  // The ticket of the command; empty when the mailbox is full.
  std::optional<std::uint64_t> send(const wire::Command& command) { return commands_.send(command); }
  wire::CommandResult poll(std::uint64_t ticket) const {
    return static_cast<wire::CommandResult>(commands_.poll(ticket));
  }
  std::optional<std::uint64_t> stage(const wire::StageRequest& request);
  wire::StageResult poll_stage(std::uint64_t ticket) const {
    return static_cast<wire::StageResult>(stage_.poll(ticket));
  }

  // Whether the Spine has mapped the code arena, where this build has it.
  bool has_arena() const;
  // A free slot of the arena, reserved for the caller until it is given back, or until the Loader has answered the
  // request that names it; 0 when there is none. A slot is free when no law in the Spine uses it, it is not reserved,
  // and the Loader has answered every request that names it. This includes requests of an earlier supervisor: their
  // slots are unknown, so all of them must be answered first.
  std::uint32_t take_slot();
  void give_back(std::uint32_t slot) { slots_[slot] = {}; }

  void heartbeat(std::int64_t now_ns);
  void press_estop();
  void release_estop();
  // "pid 17 (python3 -m lithe.gateway)" of a Brain that lives and has its e-stop word set; empty: none.
  std::string estop_holder() const;

 private:
  struct Slot {
    enum { free, taken, asked } state = free;
    std::uint64_t ticket = 0;
  };

  SpineLink(ipc::Segment<ipc::SpineMemory> spine, ipc::Segment<ipc::ControlMemory> control);
  bool predecessors_requests_are_answered();

  ipc::Segment<ipc::SpineMemory> spine_;
  ipc::Segment<ipc::ControlMemory> control_;
  wire::RobotInfo info_{};
  ipc::RingReader<wire::Telemetry, wire::spine_segment::kTelemetryDepth> telemetry_;
  ipc::RingReader<wire::Event, wire::spine_segment::kEventsTickDepth> events_tick_;
  ipc::RingReader<wire::Event, wire::spine_segment::kEventsLoaderDepth> events_loader_;
  ipc::MailboxSender<wire::Command, wire::control_segment::kCommandsDepth> commands_;
  ipc::MailboxSender<wire::StageRequest, wire::control_segment::kStageDepth> stage_;
  std::uint64_t inherited_;  // the last request of an earlier supervisor; 0 once all of them are answered
  std::array<Slot, arena::kSlots + 1> slots_{};  // [0] is not used
  std::uint32_t last_slot_ = 0;                  // they are used in turn, so the newest replaced law stays longest
};

}  // namespace lithe::control
