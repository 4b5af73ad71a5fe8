// SPDX-License-Identifier: Apache-2.0
// Finds out what is on a bus: first it listens, then it asks. Every question reads; nothing is switched on, off or
// over.
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "spine/hal/core/bus.hpp"
#include "supervisor/bus/scan/seen.hpp"

namespace lithe::field {

// Contract: not RT · one thread, which alone uses the bus · time is an argument
struct Time {
  std::function<std::int64_t()> now_ns;  // CLOCK_MONOTONIC
  std::function<void()> pause;           // a moment in which something may come
};
Time real_time();

struct Line {
  hal::Bus* bus = nullptr;  // null: it could not be opened, and is left out
  Protocol protocol = Protocol::none;
  Seen seen;
  std::uint32_t bitrate = 1'000'000;
};

// To all lines at once, for that long.
void listen(std::vector<Line>& lines, std::int64_t for_ns, const Time& time);

// Asks who is there and what they are, unless somebody else commands the bus: his answers and ours would be taken for
// each other. Takes about 0.3 s and some milliseconds per device; on slow buses of CANopen nodes up to 4 s.
void ask(Line& line, const Time& time);

}  // namespace lithe::field
