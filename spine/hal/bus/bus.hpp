// SPDX-License-Identifier: Apache-2.0
// A CAN-like bus as a driver sees it: frames out, frames in, never waiting.
#pragma once

#include <array>
#include <cstdint>

#include "spine/core/rt.hpp"

namespace lithe::hal {

// One CAN or CAN-FD frame. `size` is the number of data bytes, already one of the lengths FD knows (0-8, 12, 16 ... 64).
struct Frame {
  std::uint32_t id = 0;
  std::uint8_t size = 0;
  bool extended = false;
  bool fd = true;
  bool bit_rate_switch = true;
  std::array<std::uint8_t, 64> data{};
};

// Counted since the bus was opened.
struct BusStatistics {
  std::uint64_t sent = 0;
  std::uint64_t received = 0;
  std::uint64_t dropped = 0;  // frames that found no room
};

// Contract: RT as far as the hardware is · one thread · every call bounded
class Bus {
 public:
  virtual ~Bus() = default;
  // Hands a frame to the bus; false when there is no room (counted).
  virtual bool send(const Frame& frame, std::int64_t now_ns) LITHE_RT = 0;
  // The next frame that has arrived, in order; false when there is none.
  virtual bool receive(Frame& frame) LITHE_RT = 0;
  virtual const BusStatistics& statistics() const LITHE_RT = 0;
};

}  // namespace lithe::hal
