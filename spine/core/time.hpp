// SPDX-License-Identifier: Apache-2.0
// The two clocks: CLOCK_MONOTONIC in nanoseconds, and the raw counter that the tick reads instead.
#pragma once

#include <cstdint>

#if defined(__x86_64__)
#include <x86intrin.h>
#endif

#include "spine/core/rt.hpp"

namespace lithe {

inline constexpr std::int64_t kNsPerS = 1'000'000'000;
inline constexpr std::int64_t kNsPerMs = 1'000'000;
inline constexpr std::int64_t kNsPerUs = 1'000;

// CLOCK_MONOTONIC [ns]. On Linux this is a vDSO call, but it may fall back to a system call on an unstable
// clock source, so the tick reads RawClock instead.
std::int64_t monotonic_ns() noexcept;

// Raw counter of the core: TSC on x86-64, CNTVCT on AArch64; no system call, a few nanoseconds.
inline std::uint64_t raw_counter() LITHE_RT {
#if defined(__x86_64__)
  return __rdtsc();
#elif defined(__aarch64__)
  std::uint64_t value;
  asm volatile("mrs %0, cntvct_el0" : "=r"(value));
  return value;
#else
#error "LITHE needs x86-64 or AArch64: no raw counter is known for this machine"
#endif
}

// Tells the core that it is in a spin loop (frees pipeline resources, saves power).
inline void spin_pause() LITHE_RT {
#if defined(__x86_64__)
  _mm_pause();
#else
  asm volatile("yield");
#endif
}

// Maps the raw counter onto CLOCK_MONOTONIC: ns = base_ns + (counter - base) * scale / 2^32.
//
// The scale is fitted once and then steered: CLOCK_MONOTONIC is disciplined by NTP and the counter is not, so another
// thread calls `resample` regularly, and the tick takes over the new fit between two ticks.
// Contract: now_ns() RT · one instance per thread · calibrate() and resample() outside the tick.

// Both clocks, read as one.
struct ClockPair {
  std::uint64_t counter = 0;
  std::int64_t ns = 0;
};

class RawClock {
 public:
  RawClock() = default;
  // Through both pairs; agrees with CLOCK_MONOTONIC at `to`.
  RawClock(ClockPair from, ClockPair to);

  // Fits the scale over `window_ns` of waiting (20 ms gives better than 1 ppm with the paired reads used).
  static RawClock calibrate(std::int64_t window_ns = 20 * kNsPerMs);

  std::int64_t now_ns() const LITHE_RT { return to_ns(raw_counter()); }

  std::int64_t to_ns(std::uint64_t counter) const LITHE_RT {
    const auto delta = static_cast<std::int64_t>(counter - base_counter_);
    return base_ns_ + static_cast<std::int64_t>((static_cast<__int128>(delta) * scale_) >> 32);
  }

  // Follows to `now`, or to this instant. The scale is that of the time since the last fit and not since the first one:
  // while NTP slews CLOCK_MONOTONIC (by 500 ppm, or by much more after a step) an average over the past is wrong by the
  // whole slew. A pair that does not come after the last one changes nothing.
  RawClock resample(ClockPair now) const;
  RawClock resample() const;

  // now_ns() minus CLOCK_MONOTONIC at this instant [ns].
  std::int64_t error_ns() const;

 private:
  std::uint64_t base_counter_ = 0;
  std::int64_t base_ns_ = 0;
  std::int64_t scale_ = std::int64_t{1} << 32;  // nanoseconds per count, Q32
};

}  // namespace lithe
