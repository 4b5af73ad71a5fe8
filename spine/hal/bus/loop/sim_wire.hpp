// SPDX-License-Identifier: Apache-2.0
// The wire to simulated devices, with fault injection: loses, delays, corrupts, duplicates frames, or carries none.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "spine/hal/bus/loop/draws.hpp"
#include "spine/hal/bus/loop/loop_bus.hpp"
#include "spine/hal/core/frame.hpp"

namespace lithe::hal::sim {

// Shares of the frames in each direction, 0 to 1.
struct WireFaults {
  double drop = 0;
  double corrupt = 0;  // one bit of the data
  double duplicate = 0;
  double replay = 0;          // an older frame follows
  std::int64_t delay_ns = 0;  // of frames from the devices
  bool bus_off = false;       // no frame passes; the devices continue
};

// Used in place of the devices: passes each frame to all of them. Same seed, same faults.
// Contract: RT but for attach and detach · one thread · time is an argument
class SimWire final : public BusNode {
 public:
  explicit SimWire(std::uint64_t seed) : draws_(seed) {}

  void attach(BusNode& node) { nodes_.push_back(&node); }
  void detach(BusNode& node) { std::erase(nodes_, &node); }
  void set_faults(const WireFaults& faults) LITHE_RT { faults_ = faults; }
  const WireFaults& faults() const LITHE_RT { return faults_; }

  void on_frame(const Frame& frame, std::int64_t now_ns, FrameQueue& answers) LITHE_RT override;
  void on_time(std::int64_t now_ns, FrameQueue& answers) LITHE_RT override;

  // Time of the next delayed frame; the largest number when there is none.
  std::int64_t next_due_ns() const LITHE_RT;

 private:
  struct Late {
    std::int64_t due_ns = 0;
    Frame frame;
  };

  // Recent frames of one direction, for `replay`: repeats the frame of kPast frames ago.
  class Past {
   public:
    const Frame* next(const Frame& frame) LITHE_RT {
      Frame& place = frames_[count_++ % kPast];
      old_ = place;
      place = frame;
      return count_ > kPast ? &old_ : nullptr;
    }

   private:
    static constexpr std::size_t kPast = 8;
    std::array<Frame, kPast> frames_{};
    Frame old_;
    std::size_t count_ = 0;
  };

  void carry(const Frame& frame, std::int64_t now_ns) LITHE_RT;
  bool happens(double share) LITHE_RT { return share > 0 && draws_.share() < share; }
  void come_back(std::int64_t now_ns, FrameQueue& answers) LITHE_RT;
  void keep(const Late& late) LITHE_RT;
  Frame damaged(const Frame& frame) LITHE_RT;

  std::vector<BusNode*> nodes_;
  WireFaults faults_;
  Draws draws_;
  FrameQueue said_;
  Past told_before_;
  Past said_before_;
  std::array<Late, FrameQueue::kCapacity> late_{};  // frames without room are lost
  std::size_t head_ = 0;
  std::size_t tail_ = 0;
};

}  // namespace lithe::hal::sim
