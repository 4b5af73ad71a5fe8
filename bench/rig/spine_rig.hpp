// SPDX-License-Identifier: Apache-2.0
// All parts of a Spine without its process: real loop, guard, law and simulated drives, ticked by the bench.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "bench/rig/cycles.hpp"
#include "bench/rig/machine.hpp"
#include "spine/contain/fault_barrier.hpp"
#include "spine/hal/actuators.hpp"
#include "spine/ipc/layout.hpp"
#include "spine/law/resident.hpp"
#include "spine/law/sandbox.hpp"
#include "spine/law/slot.hpp"
#include "spine/loop/clock.hpp"
#include "spine/loop/handover.hpp"
#include "spine/loop/publish.hpp"
#include "spine/loop/spine.hpp"
#include "spine/robot/config.hpp"

namespace lithe::bench {

// Runs laws/pd.cpp on a robot file. The Transport and a Brain that publishes a plan every 20 ms have threads on the
// partner core; the calling thread ticks.
// Contract: made, ticked and destroyed on one thread, pinned to the Spine's core
class SpineRig {
 public:
  // `transport_inline`: the calling thread does the exchange too, after its tick, as `lithe run` does on two cores.
  SpineRig(const std::string& robot_file, Cores cores);
  SpineRig(robot::RobotConfig config, Cores cores, bool transport_inline = false);
  ~SpineRig();
  SpineRig(const SpineRig&) = delete;
  SpineRig& operator=(const SpineRig&) = delete;

  // Ticks the armed robot at its rate for `block_ns`, and appends what happened at each release, costs included.
  void run_block(std::int64_t block_ns, std::vector<Cycle>& cycles);

  // Waits like the Spine, but does nothing: the floor.
  void run_bare_block(std::int64_t block_ns, std::vector<Cycle>& cycles);

  // Waits like the Spine, and writes what its tick writes into shared memory, but computes nothing: the second floor.
  void run_writing_block(std::int64_t block_ns, std::vector<Cycle>& cycles);

  // While `on`, the Brain's thread offers another copy of the law with every plan, and the tick commits it.
  // Contract: any thread
  void swap_laws(bool on) { swapping_.store(on); }
  std::uint64_t offers() const { return offers_.load(); }

 private:
  void serve_buses();
  void publish_plans();
  void offer_copy();
  void arm();
  void order(wire::CommandKind kind);
  void tick_block(std::int64_t block_ns, std::vector<Cycle>& cycles);

  robot::RobotConfig config_;
  std::unique_ptr<ipc::SpineMemory> memory_ = std::make_unique<ipc::SpineMemory>();
  std::unique_ptr<ipc::ControlMemory> control_ = std::make_unique<ipc::ControlMemory>();
  std::unique_ptr<ipc::BrainMemory> brain_ = std::make_unique<ipc::BrainMemory>();
  std::unique_ptr<loop::ClockMemory> clock_ = std::make_unique<loop::ClockMemory>();
  using Residents = std::array<law::Resident, law::kResidents>;
  std::unique_ptr<Residents> laws_ = std::make_unique<Residents>();
  std::vector<law::Resident*> free_;  // used by the Brain's thread only
  ipc::MailboxSender<wire::Command, wire::control_segment::kCommandsDepth> commands_{control_->commands,
                                                                                     memory_->control_ack};
  law::Slot slot_;
  std::optional<contain::FaultBarrier> barrier_;  // the law runs contained, as in the real process
  std::optional<law::SandboxMemory> sandbox_;
  loop::Handover handover_;
  std::unique_ptr<hal::Actuators> actuators_;
  std::unique_ptr<loop::Spine> spine_;
  std::unique_ptr<ipc::SpineMemory> written_ = std::make_unique<ipc::SpineMemory>();  // by run_writing_block()
  std::unique_ptr<law::Resident> written_law_ = std::make_unique<law::Resident>();    // its State, too
  std::optional<loop::Publisher> writer_;
  std::atomic<bool> stop_{false}, swapping_{false};
  std::atomic<std::uint64_t> offers_{0};
  std::thread transport_, brain_thread_;
};

}  // namespace lithe::bench
