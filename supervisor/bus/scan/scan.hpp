// SPDX-License-Identifier: Apache-2.0
// Scans a bus: first it listens, then it asks. It only reads; it changes no mode or state.
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "spine/hal/core/bus.hpp"
#include "supervisor/bus/scan/observation.hpp"

namespace lithe::bus {

// Contract: not RT · one thread, which alone uses the bus · time is an argument
struct Time {
  std::function<std::int64_t()> now_ns;  // CLOCK_MONOTONIC
  std::function<void()> pause;           // waits briefly for frames
};
Time real_time();

struct Line {
  hal::Bus* bus = nullptr;  // null = could not be opened; left out
  Protocol protocol = Protocol::own;
  BusObservation observed;
  std::uint32_t bitrate = 1'000'000;
};

// Listens on all lines at the same time, for this long.
void listen(std::vector<Line>& lines, std::int64_t for_ns, const Time& time);

// Asks which devices are there, unless another program commands the bus: answers to it and to us could not be told
// apart. Takes about 0.3 s plus some milliseconds per device; on slow CANopen buses up to 4 s.
void ask(Line& line, const Time& time);

}  // namespace lithe::bus
