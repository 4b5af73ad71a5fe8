// SPDX-License-Identifier: Apache-2.0
#include "spine/loop/release.hpp"

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

}  // namespace

std::int64_t wait_for_release(robot::Release how, const RawClock& clock, std::int64_t release_ns,
                              std::int64_t spin_window_ns) noexcept {
  if (how == robot::Release::hybrid && clock.now_ns() < release_ns - spin_window_ns) {
    sleep_until(release_ns - spin_window_ns);
  }
  if (how == robot::Release::sleep) {
    for (std::int64_t now_ns = clock.now_ns(); now_ns < release_ns; now_ns = clock.now_ns()) sleep_until(release_ns);
    return clock.now_ns();
  }
  return wait_spinning(clock, release_ns);
}

}  // namespace lithe::loop
