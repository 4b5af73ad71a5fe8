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

// Waits until `release_ns` by spinning: no wake-up latency. Bounded by one period, the first wait by two.
inline std::int64_t wait_spinning(const RawClock& clock, std::int64_t release_ns) LITHE_RT {
  std::int64_t now_ns = clock.now_ns();
  while (now_ns < release_ns) {
    spin_pause();
    now_ns = clock.now_ns();
  }
  return now_ns;
}

// Waits for releases as the robot file says. A hybrid wait sleeps, and then spins for the last part before the release:
// the window. It is learnt from this machine's wake-up latency: what 999 of 1000 sleeps do not exceed, plus 30 us; at
// least 50 us, at most half a period.
// Contract: owned by one thread · until() between two ticks, never inside one: sleep and hybrid call the kernel
class ReleaseWait {
 public:
  ReleaseWait(robot::Release how, std::int64_t period_ns);

  // Returns the time of waking, which is never before `release_ns`.
  std::int64_t until(const RawClock& clock, std::int64_t release_ns) noexcept;

  // Takes one wake-up latency into account.
  void learn(std::int64_t latency_ns) noexcept;

  std::int64_t window_ns() const;

 private:
  robot::Release how_;
  std::int64_t most_ns_;     // of the latency
  std::int64_t latency_ns_;  // estimate of its quantile
};

}  // namespace lithe::loop
