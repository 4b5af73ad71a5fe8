// SPDX-License-Identifier: Apache-2.0
// Whether the buses of a robot can carry what its devices say: load, time of an exchange, the highest rate that fits.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "spine/robot/config.hpp"
#include "supervisor/bus/traffic.hpp"

namespace lithe::bus {

// A bus that is busier has no room to repeat a frame that was disturbed.
inline constexpr double kFullLoad = 0.8;

struct PlanOptions {
  double rate_hz = 0;      // 0: the robot's own
  std::uint32_t baud = 0;  // of every serial adapter; 0: by the robot file and its path, see plan()
  Detail detail = Detail::all;
};

struct DevicePlan {
  std::size_t device = 0;  // index into RobotConfig::devices
  std::string name;
  std::uint32_t turn = 0;  // asked in the ticks that leave this when divided by its rate divider
  std::vector<Traffic> traffic;
  double average_us = 0;  // of one exchange, all on the bus
  double worst_us = 0;
};

// Loads are shares of the time there is.
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
  double busy_us = 0;          // of that tick its frames take so much; average
  double highest_rate_hz = 0;  // 0: none

  bool real() const { return kind != robot::BusKind::loop; }
  double load() const { return load_worst > text_load ? load_worst : text_load; }
};

// One processor of a pi3hat. The Raspberry Pi talks to one after the other.
struct SpiPlan {
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

// A loop bus is planned as the CAN bus it stands for, at its bit rates: 1 and 5 Mbit/s where the file names none. A
// serial adapter carries what its baud rate carries when the file names one or its path leads to a UART (ttyS, ttyAMA,
// ttyUSB), else what USB at full speed carries: behind ttyACM there are no bauds. Drives answer within 200 us, counted
// once per bus, because one prepares while another one talks.
// Contract: pure · never in the tick · no advice in it
Plan plan(const robot::RobotConfig& robot, const PlanOptions& options);

bool fits(const BusPlan& bus, const Plan& plan);

}  // namespace lithe::bus
