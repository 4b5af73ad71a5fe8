// SPDX-License-Identifier: Apache-2.0
// `lithe bus monitor`: shows frames through the Spine that owns a bus, or from a bus without a Spine.
#include <signal.h>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <iostream>
#include <memory>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "spine/core/time.hpp"
#include "supervisor/cli/buses/spines.hpp"
#include "supervisor/cli/core/act.hpp"

namespace lithe::cli {
namespace {

volatile sig_atomic_t ended = 0;

void end_with_statistics() {
  struct sigaction action{};
  action.sa_handler = [](int) { ended = 1; };
  sigaction(SIGINT, &action, nullptr);
  sigaction(SIGTERM, &action, nullptr);
}

// Each has its turn.
class All final : public bus::FrameSource {
 public:
  void add(std::unique_ptr<bus::FrameSource> source, bool of_spine) {
    (of_spine ? spine_ : others_).push_back(source.get());
    parts_.push_back(std::move(source));
  }
  bool next(bus::CapturedFrame& captured) override {
    for (std::size_t i = 0; i < parts_.size(); ++i)
      if (parts_[turn_++ % parts_.size()]->next(captured)) return true;
    return false;
  }
  // Parts of one Spine may have the same error.
  std::string why_down() override {
    std::set<std::string> all;
    for (const auto& part : parts_) all.insert(part->why_down());
    all.erase("");
    return fmt::format("{}", fmt::join(all, "; "));
  }
  // All parts of one Spine lose the same frames.
  std::uint64_t lost() const override {
    std::uint64_t all = 0;
    for (const auto* part : spine_) all = std::max(all, part->lost());
    for (const auto* part : others_) all += part->lost();
    return all;
  }
  std::uint64_t errors(std::size_t bus) const override {
    std::uint64_t all = 0;
    for (const auto& part : parts_) all += part->errors(bus);
    return all;
  }

 private:
  std::vector<std::unique_ptr<bus::FrameSource>> parts_;
  std::vector<const bus::FrameSource*> spine_, others_;  // the same
  std::size_t turn_ = 0;
};

void warn(const std::string& words) { std::cerr << words << std::endl; }

// A bus given without a file, on which a robot runs, is that robot's bus: its file names the devices.
void know_by_file(bus::Choice& choice, std::vector<Occupied>& spines) {
  if (choice.from_file || spines.empty()) return;
  spines.resize(1);
  spines.front().ours = spines.front().theirs;
  choice = {spines.front().config, true, {spines.front().theirs}};
}

Result<> listen_in(const bus::Choice& choice, const std::vector<Occupied>& spines, All& all) {
  std::vector<std::size_t> free;
  for (const std::size_t number : choice.buses) {
    const robot::BusConfig& bus = choice.robot.buses[number];
    const auto spine = std::ranges::find_if(spines, [number](const Occupied& each) { return each.ours == number; });
    if (spine == spines.end() && !robot::is_real(bus))
      throw Refusal{"no_bus", "bus '" + bus.name + "' is simulated and lives in the Spine",
                    "start the robot (lithe run), then watch it"};
    if (spine == spines.end() || robot::facts(bus.kind).is_shared) {  // the kernel gives everybody everything
      free.push_back(number);
      continue;
    }
    auto source = watch_spine(*spine);
    if (!source) return source.error();
    all.add(std::move(*source), true);
  }
  if (free.empty()) return done();
  auto listener = bus::BusListener::open(choice, free);
  if (!listener) return listener.error();
  all.add(std::move(*listener), false);
  for (const std::size_t number : free) {
    if (robot::facts(choice.robot.buses[number].kind).is_shared) continue;
    std::cerr << "no Spine runs on " << bus::place_of(choice.robot.buses[number])
              << ": only this monitor can use it now, lithe run cannot\n";
  }
  return done();
}

}  // namespace

int bus_monitor(const Context& context, const bus::Words& words, bus::MonitorOptions options) {
  options.json = context.json;
  bus::Choice choice =
      value_of(bus::choose(words), "bad_config", "name a robot file or a bus: lithe bus monitor --help");
  std::vector<Occupied> spines = spines_on(choice, warn);
  know_by_file(choice, spines);
  bus::Monitor monitor(choice, options, monotonic_ns());
  if (const std::string complaint = monitor.complaint(); !complaint.empty())
    throw Refusal{"usage", complaint, "see the robot file"};
  All all;
  value_of(listen_in(choice, spines, all), "no_bus",
           "what is there: ip -br link, ls -l /dev/serial/by-id; how a bus is named: lithe bus monitor --help");
  end_with_statistics();
  return bus::watch(
      all, monitor, options, [] { return ended != 0; }, [](const std::string& line) { std::cout << line << std::endl; },
      warn);
}

}  // namespace lithe::cli
