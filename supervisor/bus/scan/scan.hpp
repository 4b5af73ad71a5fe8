// SPDX-License-Identifier: Apache-2.0
// Scans a bus: first it listens, then it asks. It only reads; it changes no mode or state.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "spine/hal/core/bus.hpp"
#include "spine/hal/core/bus_tools.hpp"
#include "spine/robot/config.hpp"
#include "supervisor/bus/plan/plan.hpp"
#include "supervisor/bus/scan/place.hpp"

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

// Compares the devices found on a bus with the robot file.

enum class Standing : std::uint8_t {
  expected,  // in the file and on the bus
  present,   // on a bus of which no file says anything
  unknown,   // on the bus, not in the file
  missing,   // in the file, not on the bus
  twice,     // several devices answer to this id
  unfit,     // there, but cannot be driven by LITHE
};
std::string_view word(Standing standing);

struct Judged {
  robot::DeviceKind kind = robot::DeviceKind::moteus;
  std::uint32_t id = 0;
  std::string name;  // in the file; empty where it has none
  Standing standing = Standing::present;
  std::string what;    // the device's own description, as text
  std::string advice;  // what to do next; empty = nothing
};

struct BusFindings {
  std::size_t bus = 0;  // index into the robot's buses
  std::vector<Judged> devices;
  std::string error;  // why the scan is incomplete; empty = complete
  std::string note;   // a remark that is not an error
};

// Contract: pure
BusFindings judge(const robot::RobotConfig& robot, std::size_t bus, bool from_file, const Line& line);

// Asks each device that is as the file says for what its set-up will need of it; reads only. One that would not do
// becomes unfit.
// Contract: as listen()
void look(const robot::RobotConfig& robot, BusFindings& findings, Line& line, const Time& time);

// True when the bus is as the file says.
bool matches(const BusFindings& findings);

// `lithe bus scan`: runs the scan, and prints the findings as text or JSON.

struct ScanOptions {
  double listen_s = 1.1;  // longer than the pause between two heartbeats of most devices
};

struct Scan {
  std::vector<BusFindings> buses;
  bool matches = false;  // as the file says; without a file: a device answers and there is no error
};

// Opens the chosen buses, listens to all together, then asks on one after the other. A bus that cannot be opened, and a
// loop bus, are findings, not errors.
// Contract: not RT · takes seconds · nothing it sends can move a motor
Scan scan(const Choice& choice, const ScanOptions& options);

Json to_json(const Scan& scan, const Choice& choice);
std::string to_text(const Scan& scan, const Choice& choice);

}  // namespace lithe::bus
