// SPDX-License-Identifier: Apache-2.0
// A bus in memory: what is sent reaches the simulated devices at its far end at once, and their replies wait here.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "spine/core/joints.hpp"
#include "spine/hal/bus/bus.hpp"

namespace lithe::hal {

// A device at the far end of a LoopBus.
class FarEnd {
 public:
  virtual ~FarEnd() = default;
  // Acts on `frame` if it is the device's; true if `reply` now holds an answer.
  virtual bool serve(const Frame& frame, Frame& reply, std::int64_t now_ns) LITHE_RT = 0;
};

// Contract: RT · one thread · attach() before the first frame
class LoopBus final : public Bus {
 public:
  // `device` must outlive the bus.
  void attach(FarEnd& device) { devices_.push_back(&device); }

  bool send(const Frame& frame, std::int64_t now_ns) LITHE_RT override;
  bool receive(Frame& frame) LITHE_RT override;
  const BusStatistics& statistics() const LITHE_RT override { return statistics_; }

 private:
  // Every device may answer twice before anyone listens.
  static constexpr std::size_t kDepth = 2 * kMaxJoints;
  std::vector<FarEnd*> devices_;
  std::array<Frame, kDepth> replies_{};
  std::size_t first_ = 0;
  std::size_t count_ = 0;
  BusStatistics statistics_;
};

}  // namespace lithe::hal
