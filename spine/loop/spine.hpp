// SPDX-License-Identifier: Apache-2.0
// The Spine: the loop around the control step (spine/step). It waits for releases, passes commands and samples, reads
// the requests of other processes, and publishes. The tick itself is in tick.cpp.
#pragma once

#include <atomic>
#include <cstdint>

#include "spine/contain/fault_barrier.hpp"
#include "spine/contain/memory/constants.hpp"
#include "spine/core/rt.hpp"
#include "spine/hal/actuators.hpp"
#include "spine/ipc/layout.hpp"
#include "spine/law/sandbox.hpp"
#include "spine/law/slot.hpp"
#include "spine/loop/clock.hpp"
#include "spine/loop/handover.hpp"
#include "spine/loop/host.hpp"
#include "spine/loop/inbox.hpp"
#include "spine/loop/publish.hpp"
#include "spine/loop/release.hpp"
#include "spine/robot/config.hpp"
#include "spine/step/step.hpp"

namespace lithe::loop {

// The parts that the Spine uses; all of them outlive the Spine.
struct Wiring {
  const robot::RobotConfig& robot;
  ipc::SpineMemory& spine;
  const ipc::ControlMemory& control;
  const ipc::BrainMemory& brain;
  law::Slot& slot;
  law::Sandbox& sandbox;           // the memory that a law may write
  contain::FaultBarrier* barrier;  // of the tick thread; null: a crash of a law ends the process
  Handover& handover;
  const ClockMemory& clock;
  hal::Actuators* inline_actuators;               // set when the tick thread serves the buses itself, else null
  const contain::Constants* constants = nullptr;  // memory that must not change; null = not checked
  // Whether a supervisor holds the lease of `control`, as another thread saw it last; null = none does.
  const std::atomic<bool>* supervised = nullptr;
};

// Contract: constructed off the tick · run() and tick() on the tick thread only
class Spine {
 public:
  explicit Spine(const Wiring& wiring);

  // Ticks at the robot's rate until `stop`, then switches the drives off. False: the Transport was too busy to send
  // this to all.
  bool run(const std::atomic<bool>& stop) noexcept;

  // One tick: woken at `woke_ns` for the release at `release_ns`; `skipped` releases were missed before it.
  void tick(std::int64_t release_ns, std::int64_t woke_ns, std::uint32_t skipped) LITHE_RT;

  // Without a Transport thread: does the bus exchange now. Otherwise does nothing.
  void serve_inline() LITHE_RT;

  wire::Mode mode() const LITHE_RT { return step_.mode(); }

 private:
  bool count_release(std::int64_t release_ns, std::int64_t woke_ns, std::uint32_t skipped) LITHE_RT;
  bool exchange() LITHE_RT;
  const step::Report& decide(step::Input in) LITHE_RT;
  void publish(const step::Report& report, std::int64_t release_ns, bool exchanged) LITHE_RT;
  bool stop_drives() noexcept;

  struct Timing {
    Durations durations;
    bool missed_deadline = false;                  // the previous tick ended after its deadline
    std::int64_t last_from_ns = 0, served_ns = 0;  // inline Transport: start of the last tick, and of its bus exchange
  };

  const robot::RobotConfig& robot_;
  const contain::Constants* constants_;
  Handover& handover_;
  hal::Actuators* inline_actuators_;
  SteeredClock clock_;
  ReleaseGrid grid_;
  Inbox inbox_;
  Publisher out_;
  BarrierHost host_;
  step::ControlStep step_;
  std::uint64_t tick_ = 0;
  const hal::ActuatorState* sample_;  // x_k: the newest sample, fresh or not
  Timing timing_;
  std::uint64_t state_ticks_;  // between two publications of the law's State
};

}  // namespace lithe::loop
