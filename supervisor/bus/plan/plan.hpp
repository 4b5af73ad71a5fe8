// SPDX-License-Identifier: Apache-2.0
// Bus planning: load, time of an exchange, and the highest rate that fits.
#pragma once

#include <cstddef>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "spine/hal/core/bus_tools.hpp"
#include "spine/robot/config.hpp"

namespace lithe::bus {

// Frames of one kind. Average: with their real identifiers, over payloads as random as those of a moving robot.
// Worst: no frame of this shape is longer.
struct Traffic : hal::PlannedFrame {
  bool extended = false;
  double average_us = 0;      // each, on the bus
  double worst_us = 0;        //
  double text_out_bytes = 0;  // each, on the line to a serial adapter, and back
  double text_in_bytes = 0;   //
  double spi_us = 0;          // each, between the computer and a board's processor
};

enum class Detail { all, worst_only };  // averages take a hundred times as long as all the rest

// The frames of one device, as its row in the registry tells them.
// Contract: pure · never in the tick
std::vector<Traffic> traffic_of(const robot::DeviceConfig& device, const robot::BusConfig& bus, Detail detail);

// The frames that a bus needs in addition, for example SYNC and our heartbeat. Empty for most.
std::vector<Traffic> shared_traffic(const robot::RobotConfig& robot, std::size_t bus, Detail detail);

// Above this load a bus has no room to repeat a disturbed frame.
inline constexpr double kFullLoad = 0.8;

struct PlanOptions {
  double rate_hz = 0;      // 0: the robot's own
  std::uint32_t baud = 0;  // of every serial adapter; 0: by the robot file and its path, see plan()
  Detail detail = Detail::all;
};

struct DevicePlan {
  std::size_t device = 0;  // index into RobotConfig::devices
  std::string name;
  std::uint32_t turn = 0;  // asked when tick % rate_divider is this
  std::vector<Traffic> traffic;
  double average_us = 0;  // of one exchange, all on the bus
  double worst_us = 0;
};

// Loads are shares of the available time (1 = 100 %).
struct BusPlan {
  std::string name;
  robot::BusKind kind = robot::BusKind::loop;
  std::vector<DevicePlan> devices;
  std::vector<Traffic> shared;
  double load_average = 0;
  double load_worst = 0;
  double text_load = 0;        // of the line to a serial adapter, in its busier direction; 0 = none
  double text_bytes_s = 0;     // what that line can carry
  double cycle_us = 0;         // from the first command to the last answer, in the tick that asks most; worst
  double busy_us = 0;          // time of all frames in that tick; average
  double highest_rate_hz = 0;  // 0: none

  bool real() const { return robot::facts(kind).real; }
  double load() const { return load_worst > text_load ? load_worst : text_load; }
};

// One processor of a board. The computer serves them one after the other.
struct SpiPlan {
  robot::BusKind kind = robot::BusKind::loop;
  std::string processor;
  double us = 0;  // in the tick that asks most
};

struct Plan {
  std::string robot;
  double rate_hz = 0;
  std::vector<BusPlan> buses;
  std::vector<SpiPlan> spi;
  double spi_us = 0;
  double highest_rate_hz = 0;
  bool fits = true;                 // no load above kFullLoad, every exchange within a tick
  std::vector<std::string> advice;  // sentences; where it does not fit, what to change

  double tick_us() const { return 1e6 / rate_hz; }
};

// A loop bus is planned as a CAN bus at its bit rates (default 1 and 5 Mbit/s). A serial adapter is limited by its baud
// rate when the file gives one or its path leads to a UART (ttyS, ttyAMA, ttyUSB), else by USB at full speed (ttyACM
// has no baud rate). Drives answer within 200 us, counted once per bus, because one drive prepares its answer while
// another one sends.
// Contract: pure · never in the tick · no advice in it
Plan plan(const robot::RobotConfig& robot, const PlanOptions& options);

bool fits(const BusPlan& bus, const Plan& plan);

using Json = nlohmann::ordered_json;

// Loads are shares of 1; an unlimited value (a bus without devices) is null.
Json to_json(const Plan& plan, const robot::RobotConfig& robot);

// Sentences, the most useful first: devices to move to another bus, rate dividers, a lower rate. Every change is
// planned again before it is proposed, so the changed robot fits and its file can be loaded. Empty when the robot fits
// and waits for its answers.
// Contract: pure · never in the tick
std::vector<std::string> advise(const robot::RobotConfig& robot, const PlanOptions& options);

// What `lithe run` does with a robot: start, warn or refuse.
struct Verdict {
  bool refuse = false;
  std::string text;  // one sentence with the numbers; empty = no finding
  std::string next;  // what to do
};

// Refuses when a real bus, or the serial line to its adapter, needs more than 100 % of its time with frames of average
// length. Warns when a bus has no room to repeat a frame, when an exchange may be longer than a tick, and when answers
// are not waited for. A loop bus is never refused: it takes no time.
Verdict judge_for_run(const robot::RobotConfig& robot);

}  // namespace lithe::bus
