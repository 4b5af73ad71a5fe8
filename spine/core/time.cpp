// SPDX-License-Identifier: Apache-2.0
#include "spine/core/time.hpp"

#include <ctime>
#include <limits>

namespace lithe {
namespace {

// Reads both clocks as one: of several tries the one with the shortest gap between the counter reads, so that a
// preemption between them does not matter.
ClockPair read_pair() {
  ClockPair best;
  std::uint64_t best_gap = std::numeric_limits<std::uint64_t>::max();
  for (int i = 0; i < 16; ++i) {
    const std::uint64_t before = raw_counter();
    const std::int64_t ns = monotonic_ns();
    const std::uint64_t after = raw_counter();
    if (after - before < best_gap) {
      best_gap = after - before;
      best = {before + (after - before) / 2, ns};
    }
  }
  return best;
}

}  // namespace

std::int64_t monotonic_ns() noexcept {
  timespec now{};
  clock_gettime(CLOCK_MONOTONIC, &now);
  return static_cast<std::int64_t>(now.tv_sec) * kNsPerS + now.tv_nsec;
}

RawClock::RawClock(ClockPair from, ClockPair to) : base_counter_(to.counter), base_ns_(to.ns) {
  const auto counts = static_cast<std::int64_t>(to.counter - from.counter);
  scale_ = static_cast<std::int64_t>((static_cast<__int128>(to.ns - from.ns) << 32) / (counts > 0 ? counts : 1));
}

RawClock RawClock::calibrate(std::int64_t window_ns) {
  const ClockPair from = read_pair();
  while (monotonic_ns() - from.ns < window_ns) spin_pause();
  return {from, read_pair()};
}

RawClock RawClock::resample(ClockPair now) const {
  const bool later = static_cast<std::int64_t>(now.counter - base_counter_) > 0 && now.ns > base_ns_;
  return later ? RawClock({base_counter_, base_ns_}, now) : *this;
}

RawClock RawClock::resample() const { return resample(read_pair()); }

std::int64_t RawClock::error_ns() const {
  const ClockPair now = read_pair();
  return to_ns(now.counter) - now.ns;
}

}  // namespace lithe
