// SPDX-License-Identifier: Apache-2.0
// Scans a bus: first it listens, then it asks. It only reads; it changes no mode or state.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "spine/hal/core/bus.hpp"
#include "spine/hal/core/bus_tools.hpp"
#include "spine/robot/config.hpp"

namespace lithe::bus {

using hal::Time;
Time real_time();

// A bus, and what is known of it so far. Devices are asked in one protocol, so that a question never reaches devices of
// another.
struct Line {
  explicit Line(hal::Bus* opened = nullptr, robot::Protocol protocol = robot::Protocol::own,
                std::uint32_t bitrate_hz = 1'000'000);

  // Handles a frame that is no answer to us.
  void on_frame(const hal::Frame& frame);

  struct KindScanner {
    robot::DeviceKind kind;  // the first that the scanner finds
    std::unique_ptr<hal::Scanner> scanner;
  };
  hal::Bus* bus;  // null = could not be opened; left out
  std::uint32_t bitrate;
  std::vector<KindScanner> scanners;
  std::string commander;  // evidence that another program commands this bus; empty = none
  std::string error;      // of the bus, which kept devices from being asked; empty = none
};

// Listens on all lines at the same time, for this long.
// Contract: not RT · one thread, which alone uses the buses · time is an argument
void listen(std::vector<Line>& lines, std::int64_t for_ns, const Time& time);

// Asks which devices are there, unless another program commands the bus: answers to it and to us could not be told
// apart. Takes about 0.3 s plus some milliseconds per device; on slow CANopen buses up to 4 s.
// Contract: as listen()
void ask(Line& line, const Time& time);

}  // namespace lithe::bus
