// SPDX-License-Identifier: Apache-2.0
#include "spine/core/time.hpp"

#include <ctime>
#include <limits>

namespace lithe {
namespace {

struct Pair {
  std::uint64_t counter;
  std::int64_t ns;
};

// Reads both clocks as one: of several tries the one with the shortest gap between the counter reads, so that a
// preemption between them cannot spoil the pair.
Pair read_pair() {
  Pair best{};
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

std::int64_t fit_scale(Pair from, Pair to) {
  const auto counts = static_cast<std::int64_t>(to.counter - from.counter);
  return static_cast<std::int64_t>((static_cast<__int128>(to.ns - from.ns) << 32) / (counts > 0 ? counts : 1));
}

}  // namespace

std::int64_t monotonic_ns() noexcept {
  timespec now{};
  clock_gettime(CLOCK_MONOTONIC, &now);
  return static_cast<std::int64_t>(now.tv_sec) * kNsPerS + now.tv_nsec;
}

RawClock RawClock::calibrate(std::int64_t window_ns) {
  const Pair from = read_pair();
  while (monotonic_ns() - from.ns < window_ns) spin_pause();
  const Pair to = read_pair();
  RawClock clock;
  clock.origin_counter_ = from.counter;
  clock.origin_ns_ = from.ns;
  clock.base_counter_ = to.counter;
  clock.base_ns_ = to.ns;
  clock.scale_ = fit_scale(from, to);
  return clock;
}

RawClock RawClock::resample() const {
  const Pair now = read_pair();
  RawClock clock = *this;
  clock.base_counter_ = now.counter;
  clock.base_ns_ = now.ns;
  clock.scale_ = fit_scale({origin_counter_, origin_ns_}, now);
  return clock;
}

std::int64_t RawClock::error_ns() const {
  const Pair now = read_pair();
  return to_ns(now.counter) - now.ns;
}

}  // namespace lithe
