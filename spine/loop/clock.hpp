// SPDX-License-Identifier: Apache-2.0
// A clock on CLOCK_MONOTONIC_RAW that follows CLOCK_MONOTONIC (NTP adjusts only the latter).
#pragma once

#include <cstdint>

#include "spine/core/rt.hpp"
#include "spine/core/time.hpp"
#include "spine/ipc/channel.hpp"

namespace lithe::loop {

using ClockMemory = ipc::ChannelMemory<RawClock>;

// One thread's view. follow(), called between two ticks, reads the ClockKeeper's newest fit (offset and rate against
// CLOCK_MONOTONIC). The time then jumps by less than 0.1 us; once by 25 us when NTP begins or ends a slew of 500 ppm.
// Contract: RT · one instance per thread
class SteeredClock {
 public:
  // `memory` must hold a fit already: start_clock() comes first.
  explicit SteeredClock(const ClockMemory& memory) : reader_(memory) { follow(); }

  std::int64_t now_ns() const LITHE_RT { return clock_.now_ns(); }
  const RawClock& raw() const LITHE_RT { return clock_; }
  void follow() LITHE_RT {
    RawClock fresh;
    if (reader_.read(fresh)) clock_ = fresh;
  }

 private:
  ipc::ChannelReader<RawClock> reader_;
  RawClock clock_;
};

// Publishes a first fit. Call once before any SteeredClock is made.
inline void start_clock(ClockMemory& memory) { ipc::ChannelWriter<RawClock>(memory).write(RawClock::calibrate()); }

// Publishes new fits.
// Contract: off the tick, one thread · after start_clock()
class ClockKeeper {
 public:
  static constexpr std::int64_t kEveryNs = 50 * kNsPerMs;

  explicit ClockKeeper(ClockMemory& memory) : writer_(memory) { ipc::ChannelReader<RawClock>(memory).read(clock_); }

  // Every kEveryNs.
  void renew() {
    clock_ = clock_.resample();
    writer_.write(clock_);
  }

 private:
  ipc::ChannelWriter<RawClock> writer_;
  RawClock clock_;
};

}  // namespace lithe::loop
