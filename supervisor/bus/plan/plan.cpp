// SPDX-License-Identifier: Apache-2.0
#include "supervisor/bus/plan/plan.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <limits>
#include <numeric>

#include "spine/hal/bus/serial/serial_port.hpp"
#include "spine/hal/registry.hpp"

namespace lithe::bus {

bool fits(const BusPlan& bus, const Plan& plan) { return bus.load() <= kFullLoad && bus.cycle_us <= plan.tick_us(); }

namespace {

using robot::BusConfig;
using robot::RobotConfig;

constexpr double kTurnAroundUs = 200;
constexpr double kUsbBytesPerS = 1e6;  // of the 1.2 MB/s that USB at full speed has for bulk data
constexpr double kBitsPerByte = 10;    // start, eight, stop

// Judged by the device file that the path leads to, if it exists here: a symbolic link may have any name.
bool is_uart(const std::string& path) {
  std::error_code wrong;
  const std::filesystem::path real = std::filesystem::weakly_canonical(path, wrong);
  const std::string name = (wrong ? std::filesystem::path(path) : real).filename().string();
  const auto begins = [&](const char* part) { return name.rfind(part, 0) == 0; };
  // "serial": /dev/serial0 of a Raspberry Pi is a link to a UART; on another machine the link itself must do.
  return begins("serial") || begins("ttyS") || begins("ttyAMA") || begins("ttyUSB");
}

double text_bytes_per_s(const BusConfig& bus, std::uint32_t asked_baud) {
  if (!is_serial(bus)) return 0;
  const std::uint32_t baud = asked_baud != 0 ? asked_baud : bus.baud;
  if (baud == 0 && !is_uart(bus.path)) return kUsbBytesPerS;
  return (baud != 0 ? baud : hal::kUsualBaud) / kBitsPerByte;
}

// Sums over frames: time on the bus, bytes on a serial line each way, time on SPI.
struct Sums {
  double average_us = 0, worst_us = 0, out_bytes = 0, in_bytes = 0, spi_us = 0;

  void add(const Traffic& each, double frames) {
    average_us += frames * each.average_us;
    worst_us += frames * each.worst_us;
    out_bytes += frames * each.text_out_bytes;
    in_bytes += frames * each.text_in_bytes;
    spi_us += frames * each.spi_us;
  }
  Sums& operator+=(const Sums& other) {
    for (double Sums::* each : kAll) this->*each += other.*each;
    return *this;
  }
  void raise_to(const Sums& other) {
    for (double Sums::* each : kAll) this->*each = std::max(this->*each, other.*each);
  }

 private:
  static const std::array<double Sums::*, 5> kAll;
};
const std::array<double Sums::*, 5> Sums::kAll = {&Sums::average_us, &Sums::worst_us, &Sums::out_bytes, &Sums::in_bytes,
                                                  &Sums::spi_us};

// Load of a bus: on average, and in the busiest ticks.
struct Use {
  Sums per_tick, per_s;
  std::vector<Sums> ticks;
  Sums peak;
  double longest_there_us = 0, longest_back_us = 0, longest_out = 0, longest_in = 0;
  bool answers = false;
};

template <class Visit>
void each_frame(const BusPlan& bus, Visit visit) {
  for (const Traffic& each : bus.shared) visit(each, 0U);
  for (const DevicePlan& device : bus.devices)
    for (const Traffic& each : device.traffic) visit(each, device.turn);
}

Use use_of(const BusPlan& bus, double rate_hz, std::uint32_t ticks) {
  Use use;
  use.ticks.resize(ticks);
  Sums by_clock;
  Traffic heartbeat{};
  each_frame(bus, [&](const Traffic& each, std::uint32_t turn) {
    use.per_tick.add(each, each.per_tick);
    use.per_s.add(each, each.per_s);
    (each.outbound ? use.longest_out : use.longest_in) = std::max(
        each.outbound ? use.longest_out : use.longest_in, each.outbound ? each.text_out_bytes : each.text_in_bytes);
    double& longest_us = each.outbound ? use.longest_there_us : use.longest_back_us;
    longest_us = std::max(longest_us, each.worst_us);
    use.answers = use.answers || (!each.outbound && each.per_tick > 0);
    if (each.per_tick > 0) {
      const auto divider = static_cast<std::uint32_t>(std::lround(1 / each.per_tick));
      for (std::uint32_t tick = turn % divider; tick < ticks; tick += divider) use.ticks[tick].add(each, 1);
    } else if (each.unasked) {
      by_clock.add(each, std::ceil(each.per_s / rate_hz));
    } else if (each.worst_us > heartbeat.worst_us) {
      heartbeat = each;
    }
  });
  for (Sums& tick : use.ticks) {
    tick += by_clock;        // frames sent at a device's own pace can fall into the busiest tick
    tick.add(heartbeat, 1);  // two in one tick are rare
    use.peak.raise_to(tick);
  }
  return use;
}

// The rate at which a share of `per_tick` and one of `per_s` fill a resource up to kFullLoad.
double rate_for(double per_tick, double per_s) {
  if (per_tick <= 0) return per_s > kFullLoad ? 0 : std::numeric_limits<double>::infinity();
  return std::max(kFullLoad - per_s, 0.0) / per_tick;
}

void judge(BusPlan& bus, const Use& use, double rate_hz) {
  bus.load_average = 1e-6 * (rate_hz * use.per_tick.average_us + use.per_s.average_us);
  bus.load_worst = 1e-6 * (rate_hz * use.per_tick.worst_us + use.per_s.worst_us);
  bus.busy_us = use.peak.average_us;
  bus.cycle_us = use.peak.worst_us + (use.answers ? kTurnAroundUs : 0);
  bus.highest_rate_hz = rate_for(1e-6 * use.per_tick.worst_us, 1e-6 * use.per_s.worst_us);
  if (bus.text_bytes_s <= 0) return;
  const double byte_s = 1 / bus.text_bytes_s;
  bus.text_load = byte_s * std::max(rate_hz * use.per_tick.out_bytes + use.per_s.out_bytes,
                                    rate_hz * use.per_tick.in_bytes + use.per_s.in_bytes);
  // Serial lines and CAN frames overlap in time; only the first line out and the last line back do not.
  bus.cycle_us += 1e6 * byte_s * (use.longest_out + use.longest_in);
  bus.cycle_us += std::max(0.0, 1e6 * byte_s * std::max(use.peak.out_bytes, use.peak.in_bytes) - use.peak.worst_us);
  bus.highest_rate_hz =
      std::min({bus.highest_rate_hz, rate_for(byte_s * use.per_tick.out_bytes, byte_s * use.per_s.out_bytes),
                rate_for(byte_s * use.per_tick.in_bytes, byte_s * use.per_s.in_bytes)});
}

// The buses of a board work in parallel, but one computer transfers all their frames over SPI.
void share_spi(const hal::BusType& board, const RobotConfig& robot, const std::vector<Use>& uses, Plan& plan) {
  std::vector<std::vector<double>> us(board.processors.size());
  std::vector<double> all;
  double pair_us = 0;  // the last command and the answer to it
  const double poll_us = board.poll_us(robot.buses);
  for (std::size_t i = 0; i < robot.buses.size(); ++i) {
    if (robot.buses[i].kind != board.kind || plan.buses[i].devices.empty()) continue;
    std::vector<double>& mine = us[board.processor_of(robot.buses[i])];
    all.resize(uses[i].ticks.size());
    if (mine.empty()) {
      mine.resize(all.size(), poll_us);
      for (double& tick : all) tick += poll_us;
    }
    for (std::size_t tick = 0; tick < all.size(); ++tick) {
      mine[tick] += uses[i].ticks[tick].spi_us;
      all[tick] += uses[i].ticks[tick].spi_us;
    }
    pair_us = std::max(pair_us, uses[i].longest_there_us + uses[i].longest_back_us);
  }
  if (all.empty()) return;
  const double spi_us = *std::ranges::max_element(all);
  plan.spi_us = std::max(plan.spi_us, spi_us);
  for (std::size_t i = 0; i < us.size(); ++i)
    if (!us[i].empty())
      plan.spi.push_back({board.kind, std::string(board.processors[i]), *std::ranges::max_element(us[i])});
  for (BusPlan& bus : plan.buses) {
    if (bus.kind != board.kind || bus.devices.empty()) continue;
    bus.cycle_us = std::max(bus.cycle_us, spi_us + kTurnAroundUs + pair_us);
  }
}

// The traffic repeats after this many ticks. With some combinations of dividers the period is longer and is cut here.
std::uint32_t ticks_of(const RobotConfig& robot) {
  constexpr std::uint32_t kMost = 5040;
  std::uint32_t ticks = 1;
  for (const robot::DeviceConfig& device : robot.devices) ticks = std::min(kMost, std::lcm(ticks, device.rate_divider));
  return ticks;
}

// Drives in the order of their joints, as the Spine asks them; a drive without a joint is never asked.
void add_devices(const RobotConfig& robot, Detail detail, Plan& plan) {
  const auto add = [&](std::size_t device) {
    const robot::DeviceConfig& config = robot.devices[device];
    BusPlan& bus = plan.buses[config.bus];
    DevicePlan& added = bus.devices.emplace_back();
    added.device = device;
    added.name = config.name;
    const bool together = robot::facts(config.kind).is_synced;  // one SYNC for all of them
    added.turn = together ? 0 : static_cast<std::uint32_t>(bus.devices.size() - 1) % config.rate_divider;
    added.traffic = traffic_of(config, robot.buses[config.bus], detail);
    for (const Traffic& each : added.traffic) {
      if (each.per_tick == 0 && !each.unasked) continue;
      added.average_us += each.average_us;
      added.worst_us += each.worst_us;
    }
  };
  for (const robot::JointConfig& joint : robot.joints) add(joint.device);
  for (std::size_t i = 0; i < robot.devices.size(); ++i)
    if (!robot::is_drive(robot.devices[i].kind)) add(i);
}

Plan plan_at(const RobotConfig& robot, const PlanOptions& options) {
  Plan plan;
  plan.robot = robot.name;
  plan.rate_hz = options.rate_hz > 0 ? options.rate_hz : robot.rate_hz;
  for (std::size_t i = 0; i < robot.buses.size(); ++i) {
    BusPlan& bus = plan.buses.emplace_back();
    bus.name = robot.buses[i].name;
    bus.kind = robot.buses[i].kind;
    bus.text_bytes_s = text_bytes_per_s(robot.buses[i], options.baud);
    bus.shared = shared_traffic(robot, i, options.detail);
  }
  add_devices(robot, options.detail, plan);
  const std::uint32_t ticks = ticks_of(robot);
  std::vector<Use> uses;
  for (BusPlan& bus : plan.buses) judge(bus, uses.emplace_back(use_of(bus, plan.rate_hz, ticks)), plan.rate_hz);
  for (const hal::BusType& type : hal::bus_types())
    if (type.transfer_us != nullptr) share_spi(type, robot, uses, plan);
  for (BusPlan& bus : plan.buses) {
    if (bus.cycle_us > 0) bus.highest_rate_hz = std::min(bus.highest_rate_hz, 1e6 / bus.cycle_us);
    plan.fits = plan.fits && fits(bus, plan);
  }
  return plan;
}

bool anyone_unasked(const BusPlan& bus) {
  bool found = false;
  each_frame(bus, [&](const Traffic& each, std::uint32_t) { found = found || each.unasked; });
  return found;
}

// Devices with their own clock send more frames per tick at a lower rate, so the lower rate is checked again.
void settle_highest_rate(const RobotConfig& robot, std::uint32_t baud, std::size_t bus, double& highest_hz) {
  constexpr double kLowest = 1;
  constexpr double kShare = 0.995;
  constexpr double kRounding = 1 - 1e-9;
  while (highest_hz > kLowest) {
    const Plan then = plan_at(robot, {kRounding * highest_hz, baud, Detail::worst_only});
    if (fits(then.buses[bus], then)) return;
    highest_hz = std::min(then.buses[bus].highest_rate_hz, kShare * highest_hz);
  }
  highest_hz = 0;
}

}  // namespace

Plan plan(const RobotConfig& robot, const PlanOptions& options) {
  Plan plan = plan_at(robot, options);
  plan.highest_rate_hz = std::numeric_limits<double>::infinity();
  for (std::size_t i = 0; i < plan.buses.size(); ++i) {
    double& highest_hz = plan.buses[i].highest_rate_hz;
    if (!fits(plan.buses[i], plan) && anyone_unasked(plan.buses[i]))
      settle_highest_rate(robot, options.baud, i, highest_hz);
    plan.highest_rate_hz = std::min(plan.highest_rate_hz, highest_hz);
  }
  return plan;
}

}  // namespace lithe::bus
