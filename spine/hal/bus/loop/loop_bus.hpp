// SPDX-License-Identifier: Apache-2.0
// A bus in memory: frames go to the attached nodes, and their answers come back.
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
  std::uint64_t refused() const LITHE_RT { return refused_; }  // since the start
  // An empty queue starts over, so that few frames use little cache.
  void clear() LITHE_RT { head_ = tail_ = 0; }

 private:
  std::size_t head_ = 0;
  std::size_t tail_ = 0;
  std::uint64_t refused_ = 0;
  std::array<Frame, kCapacity> frames_{};
};

// Faults that can be injected into a device, for tests and `lithe sim`.
enum class InjectedFault : std::uint8_t {
  power_loss,        // power off, and on after a moment; has no "off"
  over_temperature,  // above its temperature limit
  encoder_lost,      // it no longer knows its position
  device_fault,      // overcurrent
  watchdog_trip,     // its watchdog expires; has no "off"
  homing_lost,       // it no longer knows its turn
  other_map,         // it answers like another firmware, with other registers or objects
};

// A simulated device on a LoopBus. It gets every frame and picks its own, as on a real CAN bus.
class BusNode : public Interface {
 public:
  virtual void on_frame(const Frame& frame, std::int64_t now_ns, FrameQueue& answers) LITHE_RT = 0;
  // The frames that the device sends by itself: heartbeats, timed messages. Called about once a millisecond.
  virtual void on_time(std::int64_t /*now_ns*/, FrameQueue& /*answers*/) LITHE_RT {}
  // Puts its joint back to the start position, at rest. Its command stays.
  virtual void to_start() LITHE_RT {}
  // Injects the fault or ends it. False: this device does not have this fault.
  virtual bool inject(InjectedFault /*injected*/, bool /*begins*/, std::int64_t /*now_ns*/) LITHE_RT { return false; }
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
  // Both directions: commands, and uncollected answers.
  void count_refused() LITHE_RT { statistics_.refused = outbound_.refused() + inbound_.refused(); }

  std::int64_t now_ns_ = 0;
  FrameQueue outbound_;
  FrameQueue inbound_;
  std::vector<BusNode*> nodes_;
};

}  // namespace lithe::hal
