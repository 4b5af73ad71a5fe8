// SPDX-License-Identifier: Apache-2.0
// Interface of a bus: one exchange per tick, bounded in time and frames.
#pragma once

#include <cstdint>
#include <string>

#include "spine/core/pinned.hpp"
#include "spine/core/rt.hpp"
#include "spine/hal/core/frame.hpp"

namespace lithe::hal {

// Counters since the bus was opened; in frames, if not stated otherwise.
struct BusStatistics {
  std::uint64_t sent = 0;
  std::uint64_t received = 0;
  std::uint64_t refused = 0;    // no room: not sent, not kept
  std::uint64_t late = 0;       // arrived after their exchange, dropped by the bus
  std::uint64_t malformed = 0;  // invalid lines or frames
  std::uint64_t errors = 0;     // error frames, and refusals by an adapter
  std::uint64_t ignored = 0;    // remote frames, and other output of an adapter
  std::uint64_t reopened = 0;   // how often the hardware was reopened
};

// An exchange is begin(), send() for every command, flush(), then receive() again and again.
// Contract: RT as far as the hardware is · one thread, but for service() and why_down() · no function waits
class Bus : public Interface {
 public:
  // Begins an exchange. A bus that can tell old frames drops those that came since the last one.
  virtual void begin(std::int64_t now_ns) LITHE_RT = 0;

  // The next frame expects an answer. For hardware that waits by itself and must know.
  virtual void expect_answer() LITHE_RT {}

  // False: refused and counted, because there is no room or no hardware.
  virtual bool send(const Frame& frame) LITHE_RT = 0;

  // All commands are given: send them now.
  virtual void flush() LITHE_RT {}

  // The next frame in order of arrival. False: no more frames so far.
  virtual bool receive(Frame& frame) LITHE_RT = 0;

  // Time after flush() in which an answer may still come [ns]. 0: answers are there at once or never.
  virtual std::int64_t reply_wait_ns() const LITHE_RT { return 0; }

  // Reopens lost hardware. May open files and take long.
  // Contract: never in an exchange's thread · about once a second
  virtual void service() {}

  // Why nothing can be sent; empty = the bus works.
  // Contract: as service()
  virtual std::string why_down() const { return ""; }

  // Received frames that the kernel dropped because they were not read in time. Losses below that level (in a tty, for
  // example) are not known.
  // Contract: as service()
  virtual std::uint64_t overrun() const { return 0; }

  virtual const BusStatistics& statistics() const LITHE_RT { return statistics_; }

 protected:
  BusStatistics statistics_;
};

}  // namespace lithe::hal
