// SPDX-License-Identifier: Apache-2.0
// The double buffer between the tick and the Transport: u_k goes out while u_{k+1} is being computed.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>

#include "spine/core/rt.hpp"
#include "spine/hal/actuators.hpp"

namespace lithe::loop {

// Two counters and two pairs of buffers. `dispatched_` is written by the tick alone, `done_` by the Transport alone.
// While they are equal the Transport is idle and all buffers belong to the tick; after a dispatch, the buffers with
// index `dispatched_ & 1` belong to the Transport until `done_` has the same value. Neither side ever waits, and a
// buffer is never torn; if the Transport is late, the tick sends no command.
// Contract: RT · one tick thread, one Transport thread · wait-free on both sides
class Handover {
 public:
  // ---- tick side
  // True when the Transport has finished the last exchange: the next command can be handed over, and a sample is there.
  // acquire, with the release store in finish(): what the Transport wrote into its sample is visible.
  bool idle() const LITHE_RT { return done_.load(std::memory_order_acquire) == sent_; }

  // The buffer for the next command. Writable at any time: the Transport does not read it before dispatch().
  hal::ActuatorCommand& next_command() LITHE_RT { return command_[(sent_ + 1) & 1]; }

  // The newest finished sample. Valid until the dispatch after next: call only when idle() held at this release.
  const hal::ActuatorState& latest_sample() const LITHE_RT { return state_[sent_ & 1]; }

  // Hands next_command() over. Only when idle().
  // release, with the acquire load in pending(): the command is whole before its number is seen.
  void dispatch() LITHE_RT { dispatched_.store(++sent_, std::memory_order_release); }

  // ---- Transport side
  // True when a command is pending.
  bool pending() const LITHE_RT { return dispatched_.load(std::memory_order_acquire) != finished_; }
  const hal::ActuatorCommand& command() const LITHE_RT { return command_[(finished_ + 1) & 1]; }
  hal::ActuatorState& sample() LITHE_RT { return state_[(finished_ + 1) & 1]; }
  void finish() LITHE_RT { done_.store(++finished_, std::memory_order_release); }

 private:
  // Two cache lines apart (adjacent-line prefetch): each side polls the other's counter.
  alignas(128) std::atomic<std::uint64_t> dispatched_{0};
  std::uint64_t sent_ = 0;  // the tick's own copy
  alignas(128) std::atomic<std::uint64_t> done_{0};
  std::uint64_t finished_ = 0;  // the Transport's own copy
  alignas(128) std::array<hal::ActuatorCommand, 2> command_{};
  alignas(128) std::array<hal::ActuatorState, 2> state_{};
};

}  // namespace lithe::loop
