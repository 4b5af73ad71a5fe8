// SPDX-License-Identifier: Apache-2.0
#include "spine/loop/release.hpp"

#include <algorithm>
#include <ctime>

namespace lithe::loop {
namespace {

void sleep_until(std::int64_t at_ns) noexcept {
  timespec at{};
  at.tv_sec = at_ns / kNsPerS;
  at.tv_nsec = at_ns % kNsPerS;
  // An early return (a signal) is harmless: the caller reads the clock again.
  clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &at, nullptr);
}

constexpr std::int64_t kMarginNs = 30'000;            // above the latency
constexpr std::int64_t kLeastNs = 20'000;             // of the estimate
constexpr std::int64_t kFirstNs = 70'000;             // until it has learnt
constexpr std::int64_t kUpNs = 20'000, kDownNs = 20;  // after one that is longer, or shorter: 1 : 1000, so the p99.9

}  // namespace

ReleaseWait::ReleaseWait(robot::Release how, std::int64_t period_ns)
    : how_(how),
      most_ns_(std::max(kLeastNs, period_ns / 2 - kMarginNs)),
      latency_ns_(std::clamp(kFirstNs, kLeastNs, most_ns_)) {}

std::int64_t ReleaseWait::window_ns() const { return latency_ns_ + kMarginNs; }

void ReleaseWait::learn(std::int64_t latency_ns) noexcept {
  latency_ns_ = std::clamp(latency_ns_ + (latency_ns > latency_ns_ ? kUpNs : -kDownNs), kLeastNs, most_ns_);
}

std::int64_t ReleaseWait::until(const RawClock& clock, std::int64_t release_ns) noexcept {
  if (how_ == robot::Release::hybrid) {
    const std::int64_t wanted_ns = release_ns - window_ns();
    if (clock.now_ns() < wanted_ns) {
      sleep_until(wanted_ns);
      learn(clock.now_ns() - wanted_ns);
    }
  }
  if (how_ == robot::Release::sleep) {
    for (std::int64_t now_ns = clock.now_ns(); now_ns < release_ns; now_ns = clock.now_ns()) sleep_until(release_ns);
    return clock.now_ns();
  }
  return wait_spinning(clock, release_ns);
}

}  // namespace lithe::loop
