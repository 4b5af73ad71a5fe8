// SPDX-License-Identifier: Apache-2.0
// The Loader thread prepares a swap: it loads a law, checks it, runs it off the tick (the rehearsal), and offers it to
// the Slot.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <memory>
#include <span>

#include "lithe/law.hpp"
#include "spine/contain/fault_barrier.hpp"
#include "spine/ipc/layout.hpp"
#include "spine/law/resident.hpp"
#include "spine/law/sandbox.hpp"
#include "spine/law/slot.hpp"
#include "spine/load/law_store.hpp"

namespace lithe::load {

// Ticks a law may look back on: two seconds at 1 kHz.
inline constexpr std::uint32_t kMostPast = 2048;

// False for a record of a broken sensor. A law's init() gets finite numbers only.
bool is_finite(const wire::Telemetry& record, std::uint32_t joints);

// The first calls of new code: init, and a few harmless steps, on copies.
// Contract: Loader thread only · allocates when made, never after · without a FaultBarrier, a law that crashes here
// ends the process
class Rehearsal {
 public:
  // `joints` and `dt_s` are the robot's; `sandbox` is the Loader's own.
  Rehearsal(const ipc::SpineMemory& spine, std::uint32_t joints, double dt_s, law::Sandbox& sandbox);

  void use(contain::FaultBarrier* barrier) { barrier_ = barrier; }

  // Prepares a new law for its commit: runs its init() on the past, and warms its pages and cache lines. False, with
  // one sentence in `why`, when it fails or an output is not finite.
  bool prepare(law::Resident& law, std::int64_t now_ns, std::span<char> why);

 private:
  bool start(law::Resident& law, std::int64_t now_ns, std::span<char> why);
  bool dry_steps(const law::Resident& law, std::span<char> why);
  bool contained(contain::FaultBarrier::Call call, void* context, const char* what, std::span<char> why);
  const History& look_back(std::int64_t now_ns);

  const ipc::SpineMemory& spine_;
  std::uint32_t joints_;
  double dt_s_;
  law::Sandbox& sandbox_;
  contain::FaultBarrier* barrier_ = nullptr;
  law::Resident scratch_{};  // the dry steps' copy
  std::unique_ptr<std::array<PastTick, kMostPast>> past_;
  History history_;
  wire::Telemetry record_{};
};

// A candidate that no tick has committed after this long is taken back.
inline constexpr std::int64_t kCommitTimeoutNs = 2'000'000'000;

// Every byte of a StageRequest may be hostile. Outputs: events in the ring events_loader, a wire::StageResult for each
// request, and a LawInfo for each law in memory (index = Resident::index; law_id 0 = empty).
// Contract: owned by one housekeeping thread · allocates nothing beyond dlopen · logs through shared memory only
class Loader {
 public:
  // `arena`: for requests that name a slot, nullptr = there is none; `store`: for all others.
  Loader(law::Slot& slot, LawStore& store, ipc::SpineMemory& spine, const ipc::ControlMemory& control,
         Rehearsal& rehearsal, LawStore* arena = nullptr);

  // Body of the Loader thread: polls every millisecond until `stop`.
  void run(const std::atomic<bool>& stop);

  // One round: unloads laws that the tick has retired, then handles at most one request. True if it did anything.
  bool poll(std::int64_t now_ns);

  // Loads a law without a request, as main does for the first law. Events and LawInfo as usual.
  wire::StageResult stage(const wire::StageRequest& request, std::int64_t now_ns);

 private:
  using Receiver = ipc::MailboxReceiver<wire::StageRequest, wire::control_segment::kStageDepth>;
  using EventWriter = ipc::RingWriter<wire::Event, wire::spine_segment::kEventsLoaderDepth>;
  using Text = std::array<char, 256>;

  bool retire_one(std::int64_t now_ns);
  bool candidate_waits(std::int64_t now_ns);
  law::Resident* free_resident();
  wire::StageResult prepare(law::Resident& resident, const wire::StageRequest& request, Text& why);
  void plan_all_migrations(law::Resident& candidate);
  void unload(const law::Resident& resident);
  void release(law::Resident& resident);
  void publish_info(const law::Resident& resident);
  void tell(wire::EventKind kind, std::uint64_t request_id, std::uint32_t code, double value, const char* text,
            std::int64_t now_ns);

  law::Slot& slot_;
  LawStore& store_;
  LawStore* arena_;
  ipc::SpineMemory& spine_;
  Receiver requests_;
  EventWriter events_;
  Rehearsal& rehearsal_;
  std::uint32_t next_id_ = 1;
  law::Resident* waiting_ = nullptr;  // offered, not yet active
  std::int64_t offered_ns_ = 0;
  std::array<bool, law::kResidents> used_{};
  std::array<law::Resident, law::kResidents> residents_{};
  wire::StageRequest request_{};
  wire::LawInfo info_{};
};

}  // namespace lithe::load
