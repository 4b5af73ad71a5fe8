// SPDX-License-Identifier: Apache-2.0
// What every bus can do: one exchange per tick, bounded in time and in frames.
#pragma once

#include <cstddef>
#include <cstdint>

#include "spine/core/rt.hpp"
#include "spine/hal/bus/frame.hpp"

namespace lithe::hal {

// Frames since the bus was opened.
struct BusStatistics {
  std::uint64_t sent = 0;
  std::uint64_t received = 0;
  std::uint64_t refused = 0;  // the queue was full: not sent, not kept
  std::uint64_t late = 0;     // arrived after the exchange they belonged to, thrown away
};

// An exchange is begin(), send() for every command, then receive() until it says that nothing more comes.
// Contract: RT as far as the hardware is · one thread · never blocks longer than the bus's own bound
class Bus {
 public:
  Bus() = default;
  Bus(const Bus&) = delete;
  Bus& operator=(const Bus&) = delete;
  virtual ~Bus() = default;

  // Opens an exchange and throws away what came since the last one: a reply is never taken for the next one.
  virtual void begin(std::int64_t now_ns) LITHE_RT = 0;

  // False: refused and counted, because the queue is full.
  virtual bool send(const Frame& frame) LITHE_RT = 0;

  // The next frame in order of arrival. False: nothing more comes in this exchange.
  virtual bool receive(Frame& frame) LITHE_RT = 0;

  const BusStatistics& statistics() const LITHE_RT { return statistics_; }

 protected:
  BusStatistics statistics_;
};

}  // namespace lithe::hal
