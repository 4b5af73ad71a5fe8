// SPDX-License-Identifier: Apache-2.0
#include "supervisor/bus/plan/plan.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <set>

namespace lithe::bus {
namespace {

using robot::BusConfig;
using robot::DeviceConfig;
using robot::RobotConfig;

constexpr std::uint32_t kLargestDivider = 8;
constexpr double kCommandsPerWatchdog = 4;  // as load_robot demands
constexpr std::uint32_t kLargestId = 126;
constexpr double kLowestRateHz = 100;  // as load_robot demands

// Excess load of all buses; less is better. The sum counts every bus, so that a change does not just move the load.
double excess(const Plan& plan) {
  double sum = 0;
  for (const BusPlan& bus : plan.buses)
    sum += std::max(0.0, bus.load() - kFullLoad) + std::max(0.0, bus.cycle_us / plan.tick_us() - 1);
  return sum;
}

bool may_live_on(const RobotConfig& robot, const DeviceConfig& device, std::size_t target) {
  const BusConfig& bus = robot.buses[target];
  // A device does not move between a real and a simulated bus.
  if (is_real(bus) != is_real(robot.buses[device.bus])) return false;
  const robot::DeviceFacts& kind = robot::facts(device.kind);
  if ((kind.needs_fd && !is_fd(bus)) || (kind.needs_classic && !carries_classic(bus))) return false;
  return std::ranges::all_of(robot.devices, [&](const DeviceConfig& other) {
    return other.bus != target || robot::go_together(other.kind, device.kind);
  });
}

// 0: there is none.
std::uint32_t free_id(const RobotConfig& robot, std::size_t bus, std::uint32_t wanted) {
  std::set<std::uint32_t> taken;
  for (const DeviceConfig& other : robot.devices)
    if (other.bus == bus) taken.insert(other.id);
  if (taken.count(wanted) == 0) return wanted;
  for (std::uint32_t id = 1; id <= kLargestId; ++id)
    if (taken.count(id) == 0) return id;
  return 0;
}

constexpr std::string_view kNoRate = "no rate fits: take devices off the bus, or add another bus";

// A round number that fits and is allowed in a robot file; 0 = none.
double round_rate(const Plan& plan) {
  const double rate_hz = std::floor(plan.highest_rate_hz / 10) * 10;
  return rate_hz >= kLowestRateHz ? rate_hz : 0;
}

// At a lower rate drives are asked less often, so their watchdogs must be longer. Empty when they are long enough.
std::string watchdogs_for(const RobotConfig& robot, double rate_hz) {
  double needed_s = 0;
  for (const DeviceConfig& device : robot.devices) {
    const double least_s = kCommandsPerWatchdog * device.rate_divider / rate_hz;
    if (robot::facts(device.kind).asked && device.watchdog_s < least_s) needed_s = std::max(needed_s, least_s);
  }
  return needed_s > 0 ? fmt::format(", with watchdog_s = {:g} or more", std::ceil(1000 * needed_s) / 1000) : "";
}

std::string short_wait(const BusPlan& bus, const BusConfig& config) {
  if (!bus.real() || bus.cycle_us <= 1e6 * config.reply_wait_s) return "";
  return fmt::format("{}: an exchange may take {:.0f} us, which reply_wait_s = {:g} does not wait for", bus.name,
                     bus.cycle_us, config.reply_wait_s);
}

// Tries changes on a copy of the robot and keeps those that help, each with its sentence.
class Adviser {
 public:
  Adviser(const RobotConfig& robot, const PlanOptions& options)
      : robot_(robot), options_(options), now_(plan(robot, options)) {}

  std::vector<std::string> run() {
    while (!now_.fits && (move_one() || divide_one())) {
    }
    if (!now_.fits) lower_rate();
    return said_;
  }

 private:
  bool overloaded(std::size_t bus) const { return !fits(now_.buses[bus], now_); }

  // The move that leaves the least excess, onto a bus that still fits afterwards.
  bool move_one() {
    double best = excess(now_);
    std::size_t mover = 0, target = 0;
    RobotConfig kept;
    for (std::size_t i = 0; i < robot_.devices.size(); ++i) {
      if (!overloaded(robot_.devices[i].bus)) continue;
      for (std::size_t bus = 0; bus < robot_.buses.size(); ++bus) {
        if (bus == robot_.devices[i].bus || overloaded(bus) || !may_live_on(robot_, robot_.devices[i], bus)) continue;
        RobotConfig tried = robot_;
        tried.devices[i].id = free_id(robot_, bus, robot_.devices[i].id);
        if (tried.devices[i].id == 0) continue;
        tried.devices[i].bus = bus;
        const Plan then = plan(tried, options_);
        if (!fits(then.buses[bus], then) || excess(then) >= best - 1e-9) continue;
        best = excess(then);
        mover = i;
        target = bus;
        kept = std::move(tried);
      }
    }
    if (kept.buses.empty()) return false;
    accept(kept, say_move(mover, target, kept.devices[mover].id));
    return true;
  }

  std::string say_move(std::size_t device, std::size_t target, std::uint32_t id) const {
    const DeviceConfig& moved = robot_.devices[device];
    const std::string with = id == moved.id ? "" : fmt::format(", there with id {}", id);
    return fmt::format("move \"{}\" from {} to {}{}", moved.name, robot_.buses[moved.bus].name,
                       robot_.buses[target].name, with);
  }

  // The smallest rate divider with which the busiest bus fits, for all its drives that are asked most often.
  bool divide_one() {
    std::size_t worst = robot_.buses.size();
    for (std::size_t bus = 0; bus < robot_.buses.size(); ++bus)
      if (overloaded(bus) && (worst == robot_.buses.size() || now_.buses[bus].load() > now_.buses[worst].load()))
        worst = bus;
    std::uint32_t least = kLargestDivider;
    for (const DevicePlan& each : now_.buses[worst].devices)
      if (is_drive(each)) least = std::min(least, robot_.devices[each.device].rate_divider);
    for (std::uint32_t divider = least + 1; divider <= kLargestDivider; ++divider) {
      RobotConfig tried = robot_;
      std::string names;
      for (const DevicePlan& each : now_.buses[worst].devices) {
        DeviceConfig& device = tried.devices[each.device];
        if (!is_drive(each) || device.rate_divider != least) continue;
        if (device.watchdog_s * now_.rate_hz / divider < kCommandsPerWatchdog) return false;  // it would time out
        device.rate_divider = divider;
        names += fmt::format("{}\"{}\"", names.empty() ? "" : ", ", device.name);
      }
      const Plan then = plan(tried, options_);
      if (!fits(then.buses[worst], then)) continue;
      accept(tried, fmt::format("ask {} less often: rate_divider = {}", names, divider));
      return true;
    }
    return false;
  }

  bool is_drive(const DevicePlan& plan) const { return robot::is_drive(robot_.devices[plan.device].kind); }

  void accept(const RobotConfig& changed, std::string sentence) {
    Plan then = plan(changed, options_);
    for (std::size_t bus = 0; bus < then.buses.size(); ++bus) {
      const double before = now_.buses[bus].load(), after = then.buses[bus].load();
      if (std::abs(before - after) < 0.005) continue;
      sentence += fmt::format("; {} {:.0f} -> {:.0f} %", then.buses[bus].name, 100 * before, 100 * after);
    }
    said_.push_back(std::move(sentence));
    robot_ = changed;
    now_ = std::move(then);
  }

  void lower_rate() {
    const double rate_hz = round_rate(now_);
    said_.push_back(rate_hz > 0 ? fmt::format("lower rate_hz to {:g}{}", rate_hz, watchdogs_for(robot_, rate_hz))
                                : std::string(kNoRate));
  }

  RobotConfig robot_;
  PlanOptions options_;
  Plan now_;
  std::vector<std::string> said_;
};

}  // namespace

std::vector<std::string> advise(const RobotConfig& robot, const PlanOptions& wanted) {
  PlanOptions options = wanted;
  options.detail = Detail::worst_only;  // up to a hundred variants are planned
  std::vector<std::string> all = Adviser(robot, options).run();
  const Plan as_it_is = plan(robot, options);
  // The alternative that needs no rewiring.
  const double rate_hz = round_rate(as_it_is);
  if (!all.empty() && all.back().rfind("lower rate_hz", 0) != 0 && rate_hz > 0)
    all.push_back(fmt::format("or leave all that and set rate_hz = {:g}{}", rate_hz, watchdogs_for(robot, rate_hz)));
  for (std::size_t i = 0; i < as_it_is.buses.size(); ++i) {
    const std::string wait = short_wait(as_it_is.buses[i], robot.buses[i]);
    if (!wait.empty()) all.push_back(wait);
  }
  return all;
}

Verdict judge_for_run(const RobotConfig& robot) {
  const Plan now = plan(robot, {});
  Verdict verdict;
  for (const BusPlan& bus : now.buses) {
    if (!bus.real() || fits(bus, now)) continue;
    const bool impossible = bus.load_average > 1 || bus.text_load > 1 || bus.busy_us > now.tick_us();
    if (verdict.refuse && !impossible) continue;
    if (verdict.refuse == impossible && !verdict.text.empty()) continue;  // report the first finding of the worse kind
    verdict.refuse = impossible;
    verdict.text = fmt::format(
        "bus \"{}\" would be {:.0f} % busy at {:g} Hz (average {:.0f} %), an exchange would take up to {:.0f} us of "
        "{:.0f}; {}",
        bus.name, 100 * bus.load(), now.rate_hz, 100 * bus.load_average, bus.cycle_us, now.tick_us(),
        bus.highest_rate_hz >= 1 ? fmt::format("{:.0f} Hz fit", std::floor(bus.highest_rate_hz)) : "no rate fits");
    verdict.next = fmt::format("lithe bus plan {} tells what to move", robot.path);
    if (const double rate_hz = round_rate(now); rate_hz > 0)
      verdict.next += fmt::format(", or set rate_hz = {:g}{}", rate_hz, watchdogs_for(robot, rate_hz));
  }
  for (std::size_t i = 0; i < now.buses.size() && verdict.text.empty(); ++i) {
    verdict.text = short_wait(now.buses[i], robot.buses[i]);
    if (!verdict.text.empty()) verdict.next = "give it a longer reply_wait_s, or leave that out";
  }
  return verdict;
}

}  // namespace lithe::bus
