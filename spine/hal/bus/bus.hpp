// SPDX-License-Identifier: Apache-2.0
// What every bus can do: one exchange per tick, bounded in time and in frames.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>

#include "spine/core/rt.hpp"
#include "spine/hal/bus/frame.hpp"

namespace lithe::hal {

// Since the bus was opened. Frames, unless it says otherwise.
struct BusStatistics {
  std::uint64_t sent = 0;
  std::uint64_t received = 0;
  std::uint64_t refused = 0;    // no room: not sent, not kept
  std::uint64_t late = 0;       // arrived after the exchange they belonged to, thrown away by the bus
  std::uint64_t malformed = 0;  // lines or frames that make no sense
  std::uint64_t errors = 0;     // error frames, and answers of an adapter that say no
  std::uint64_t ignored = 0;    // remote frames, and what an adapter says beside frames and answers
  std::uint64_t reopened = 0;   // times that the hardware came back
};

// An exchange is begin(), send() for every command, flush(), then receive() again and again.
// Contract: RT as far as the hardware is · one thread, but for service() and why_down() · nothing ever waits
class Bus {
 public:
  Bus() = default;
  Bus(const Bus&) = delete;
  Bus& operator=(const Bus&) = delete;
  virtual ~Bus() = default;

  // Opens an exchange. A bus that can tell throws away what came since the last one.
  virtual void begin(std::int64_t now_ns) LITHE_RT = 0;

  // The next frame will be answered, and the answer waited for. For hardware that waits by itself and must know.
  virtual void expect_answer() LITHE_RT {}

  // False: refused and counted, because there is no room or no hardware.
  virtual bool send(const Frame& frame) LITHE_RT = 0;

  // The last command is in: they leave now.
  virtual void flush() LITHE_RT {}

  // The next frame in order of arrival. False: nothing more has arrived so far.
  virtual bool receive(Frame& frame) LITHE_RT = 0;

  // For so long after flush() an answer may still come [ns]. 0: what is not there already never comes.
  virtual std::int64_t reply_wait_ns() const LITHE_RT { return 0; }

  // Brings back hardware that went away. May open files, and take long.
  // Contract: never in an exchange's thread · about once a second
  virtual void service() {}

  // Why nothing can be sent; empty when all is well.
  // Contract: as service()
  virtual std::string why_down() const { return ""; }

  // Frames that came, and that the system threw away because nobody fetched them in time; of those below it, a tty's
  // for one, nobody knows.
  // Contract: as service()
  virtual std::uint64_t overrun() const { return 0; }

  virtual const BusStatistics& statistics() const LITHE_RT { return statistics_; }

 protected:
  BusStatistics statistics_;
};

}  // namespace lithe::hal
