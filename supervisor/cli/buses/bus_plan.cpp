// SPDX-License-Identifier: Apache-2.0
// `lithe bus plan`: from the robot file alone; no robot needs to run.
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <cmath>
#include <iostream>
#include <string>
#include <vector>

#include "spine/robot/robot.hpp"
#include "supervisor/bus/plan/plan.hpp"
#include "supervisor/cli/buses/spines.hpp"
#include "supervisor/cli/core/act.hpp"

namespace lithe::cli {
namespace {

constexpr int kDoesNotFit = 1;

std::string percent(double share) { return fmt::format("{:.0f} %", 100 * share); }

std::string hertz(double rate_hz) { return std::isfinite(rate_hz) ? fmt::format("{:.0f}", std::floor(rate_hz)) : "-"; }

void print_device(const bus::DevicePlan& plan, const robot::DeviceConfig& device) {
  std::string frames;
  for (const bus::Traffic& each : plan.traffic)
    if (each.per_tick > 0 || each.unasked)
      frames += fmt::format("{}{} {}", frames.empty() ? "" : ", ", each.what, each.size);
  const std::string often = device.rate_divider == 1 || !robot::is_drive(device.kind)
                                ? ""
                                : fmt::format(", in one of {} ticks", device.rate_divider);
  fmt::print("  {:<22} {:<8} id {:<4} {:>4.0f} us, at most {:.0f}: {} bytes{}\n", device.name,
             std::string(robot::word(device.kind)), device.id, plan.average_us, plan.worst_us, frames, often);
}

void print_plan(const bus::Plan& plan, const robot::RobotConfig& robot) {
  fmt::print("robot '{}' at {:g} Hz: {:.0f} us a tick\n\n", plan.robot, plan.rate_hz, plan.tick_us());
  fmt::print("{:<12} {:<10} {:>8} {:>8} {:>8} {:>12} {:>11}\n", "bus", "kind", "average", "worst", "text",
             "exchange us", "highest Hz");
  bool loops = false;
  for (const bus::BusPlan& each : plan.buses) {
    loops = loops || !each.real();
    fmt::print("{:<12} {:<10} {:>8} {:>8} {:>8} {:>12.0f} {:>11}{}\n", each.name,
               std::string(robot::word(each.kind)) + (each.real() ? "" : " *"), percent(each.load_average),
               percent(each.load_worst), each.text_bytes_s > 0 ? percent(each.text_load) : "-", each.cycle_us,
               hertz(each.highest_rate_hz), bus::fits(each, plan) ? "" : "  DOES NOT FIT");
    for (const bus::DevicePlan& device : each.devices) print_device(device, robot.devices[device.device]);
  }
  for (const bus::SpiPlan& each : plan.spi)
    fmt::print("{} {:<8} {:.0f} us of SPI a tick\n", robot::word(each.kind), each.processor, each.us);
  if (loops) fmt::print("\n* in memory: planned as the CAN bus that it stands for\n");
  fmt::print("\n{}; the highest rate that fits: {} Hz\n", plan.fits ? "fits" : "DOES NOT FIT",
             hertz(plan.highest_rate_hz));
  for (const std::string& each : plan.advice) fmt::print("  {}\n", each);
}

}  // namespace

int bus_plan(const Context& context, const std::string& file, const bus::PlanOptions& options) {
  const robot::RobotConfig robot = value_of(robot::load_robot(file), "bad_config", "correct the file, or name another");
  bus::Plan plan = bus::plan(robot, options);
  plan.advice = bus::advise(robot, options);
  finish(context, bus::to_json(plan, robot), [&](const Json&) { print_plan(plan, robot); });
  return plan.fits ? 0 : kDoesNotFit;
}

// `lithe bus scan`: refuses a bus that a running robot uses.

int bus_scan(const Context& context, const bus::Words& words, const bus::ScanOptions& options) {
  const bus::Choice choice =
      value_of(bus::choose(words), "bad_config", "name a robot file or a bus: lithe bus scan --help");
  std::vector<std::string> spines;
  for (const Occupied& each : spines_on(choice, [](const std::string& doubt) { std::cerr << doubt << std::endl; })) {
    const bool real = robot::is_real(each.config.buses[each.theirs]);
    if (real) spines.push_back(each.words());
  }
  if (!spines.empty()) {
    throw Refusal{"robot_running", fmt::format("a Spine works on this hardware: {}", fmt::join(spines, ", ")),
                  "stop it first: lithe stop; or watch its bus: lithe bus monitor"};
  }
  const bus::Scan scan = bus::scan(choice, options);
  finish(context, bus::to_json(scan, choice), [&](const Json&) { fmt::print("{}", bus::to_text(scan, choice)); });
  return scan.matches ? 0 : 1;
}

}  // namespace lithe::cli
