// SPDX-License-Identifier: Apache-2.0
// The release grid: when each tick is due, and how the Spine waits for it.
#pragma once

#include <cstdint>

#include "spine/core/rt.hpp"
#include "spine/core/time.hpp"
#include "spine/robot/config.hpp"

namespace lithe::loop {

// Releases lie at phase_ns + n * period_ns of CLOCK_MONOTONIC. The phase keeps them off the kernel's own timer tick,
// which fires on whole milliseconds (docs/rt.md).
// Contract: RT · owned by the tick thread
class ReleaseGrid {
 public:
  ReleaseGrid(std::int64_t period_ns, std::int64_t phase_ns) : period_ns_(period_ns), phase_ns_(phase_ns) {}

  // The first release is the first grid point at least one period away.
  void start(std::int64_t now_ns) LITHE_RT {
    const std::int64_t earliest_ns = now_ns + period_ns_;
    release_ns_ = phase_ns_ + (earliest_ns - phase_ns_ + period_ns_ - 1) / period_ns_ * period_ns_;
  }

  // Advances to the next release that is less than one period in the past, and returns the number of skipped releases
  // (those without a tick). A release that is only late is not skipped: it runs at once, and its release jitter shows
  // the delay.
  std::uint32_t advance(std::int64_t now_ns) LITHE_RT {
    release_ns_ += period_ns_;
    const std::int64_t behind_ns = now_ns - release_ns_;
    if (behind_ns < period_ns_) return 0;
    const std::int64_t skipped = behind_ns / period_ns_;
    release_ns_ += skipped * period_ns_;
    return static_cast<std::uint32_t>(skipped);
  }

  std::int64_t release_ns() const LITHE_RT { return release_ns_; }
  std::int64_t period_ns() const LITHE_RT { return period_ns_; }

 private:
  std::int64_t period_ns_;
  std::int64_t phase_ns_;
  std::int64_t release_ns_ = 0;
};

// Waits until `release_ns` by spinning: no wake-up latency. Bounded by one period.
inline std::int64_t wait_spinning(const RawClock& clock, std::int64_t release_ns) LITHE_RT {
  std::int64_t now_ns = clock.now_ns();
  while (now_ns < release_ns) {
    spin_pause();
    now_ns = clock.now_ns();
  }
  return now_ns;
}

// Waits until `release_ns` as `how` says and returns the time of waking. `spin_window_ns` is how long before the
// release a hybrid wait stops sleeping: longer than the platform's wake-up latency.
// Contract: between two ticks, never inside one: sleep and hybrid call the kernel.
std::int64_t wait_for_release(robot::Release how, const RawClock& clock, std::int64_t release_ns,
                              std::int64_t spin_window_ns) noexcept;

}  // namespace lithe::loop
