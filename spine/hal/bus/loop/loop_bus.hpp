// SPDX-License-Identifier: Apache-2.0
// A bus in memory: what is sent reaches the nodes at its far end, and what they answer comes back.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "spine/core/rt.hpp"
#include "spine/hal/core/bus.hpp"
#include "spine/hal/core/frame.hpp"

namespace lithe::hal {

// First in, first out, of fixed capacity.
// Contract: RT · one thread
class FrameQueue {
 public:
  static constexpr std::size_t kCapacity = 256;

  // False when full: counted, and the queue is unchanged.
  bool push(const Frame& frame) LITHE_RT {
    if (size() == kCapacity) {
      ++refused_;
      return false;
    }
    frames_[head_++ % kCapacity] = frame;
    return true;
  }
  // Null when empty; valid until the next push or pop.
  const Frame* front() const LITHE_RT { return size() == 0 ? nullptr : &frames_[tail_ % kCapacity]; }
  void pop() LITHE_RT {
    if (++tail_ == head_) clear();
  }
  std::size_t size() const LITHE_RT { return head_ - tail_; }
  std::uint64_t refused() const LITHE_RT { return refused_; }  // ever
  // An empty queue starts over, so that few frames use little cache.
  void clear() LITHE_RT { head_ = tail_ = 0; }

 private:
  std::size_t head_ = 0;
  std::size_t tail_ = 0;
  std::uint64_t refused_ = 0;
  std::array<Frame, kCapacity> frames_{};
};

// What may befall a device, for tests and `lithe sim`.
enum class Mishap : std::uint8_t {
  power_loss,        // gone, and back after a moment; has no end of its own
  over_temperature,  // as hot as it may not be
  encoder_lost,      // it no longer knows its position
  device_fault,      // too much current
  watchdog_trip,     // for it, its host has fallen silent; has no end of its own
  homing_lost,       // it no longer knows in which turn it is
  other_map,         // it answers as another firmware would, with other registers or objects
};

// Something at the far end of a LoopBus. It sees every frame and picks its own, as on a real CAN bus.
class BusNode {
 public:
  BusNode() = default;
  BusNode(const BusNode&) = delete;
  BusNode& operator=(const BusNode&) = delete;
  virtual ~BusNode() = default;
  virtual void on_frame(const Frame& frame, std::int64_t now_ns, FrameQueue& answers) LITHE_RT = 0;
  // What it says by itself by now: heartbeats, timed messages. Called about once a millisecond.
  virtual void on_time(std::int64_t /*now_ns*/, FrameQueue& /*answers*/) LITHE_RT {}
  // Its joint is where it began, at rest: somebody has put it there by hand. What it was commanded stays.
  virtual void to_start() LITHE_RT {}
  // The mishap begins or ends. False: such a thing cannot happen to this device.
  virtual bool befall(Mishap /*mishap*/, bool /*begins*/, std::int64_t /*now_ns*/) LITHE_RT { return false; }
};

// Lossless and in order up to FrameQueue::kCapacity frames each way; beyond that it refuses and counts.
// Contract: RT · one thread · nodes are attached before the first exchange and outlive the bus's last
class LoopBus final : public Bus {
 public:
  // Contract: never in the tick
  void attach(BusNode& node) { nodes_.push_back(&node); }

  void begin(std::int64_t now_ns) LITHE_RT override;
  bool send(const Frame& frame) LITHE_RT override;
  bool receive(Frame& frame) LITHE_RT override;

 private:
  void deliver() LITHE_RT;
  void count_refused() LITHE_RT;

  std::int64_t now_ns_ = 0;
  FrameQueue outbound_;
  FrameQueue inbound_;
  std::vector<BusNode*> nodes_;
};

}  // namespace lithe::hal
