// SPDX-License-Identifier: Apache-2.0
#include "sim/world.hpp"

#include <algorithm>
#include <cmath>
#include <filesystem>

#include "spine/hal/sim/simulate.hpp"

namespace lithe::simulator {
namespace {

using Kind = FaultRequest::Kind;

// An order names one bus or device, or none, which means all.
bool is_meant(const std::string& named, const std::string& name) { return named.empty() || named == name; }

std::int64_t ns_of(double seconds) { return std::llround(1e9 * seconds); }

}  // namespace

Result<std::unique_ptr<World>> World::open(const robot::RobotConfig& config, const Options& options, Say say) {
  auto world = std::make_unique<World>();
  world->say_ = std::move(say);
  if (!options.link_folder.empty()) {
    std::error_code wrong;
    std::filesystem::create_directories(options.link_folder, wrong);
    if (wrong) return Error{"cannot make the folder " + options.link_folder + ": " + wrong.message()};
  }
  Result<std::unique_ptr<Devices>> devices = Devices::make(config, options.seed);
  if (!devices) return Error{config.path + ": " + devices.message()};
  world->devices_ = std::move(*devices);
  for (std::size_t i = 0; i < config.buses.size(); ++i)
    if (Result<> added = world->add_bus(config, i, options); !added) return added.error();
  world->tell_places();
  return world;
}

Result<> World::add_bus(const robot::RobotConfig& config, std::size_t index, const Options& options) {
  const robot::BusConfig& bus = config.buses[index];
  hal::sim::SimWire& wire = devices_->wire(index);
  const hal::sim::SimBusType& type = hal::sim::type_of(bus.kind);
  const auto add = [&](auto end) -> Result<> {
    if (!end) return Error{"bus '" + bus.name + "': " + end.message()};
    ends_.push_back(std::move(*end));
    lines_.push_back({bus.name, std::string(type.adapter), type.make_adapter == nullptr, ""});
    return done();
  };
  if (type.make_adapter == nullptr)
    return add(
        CanEnd::open({.interface = bus.interface, .bitrate = bus.bitrate, .data_bitrate = bus.data_bitrate}, wire));
  std::unique_ptr<hal::sim::SimAdapter> adapter = type.make_adapter();
  adapter->attach(wire);
  return add(PtyEnd::open(std::move(adapter), options.link_folder.empty() ? "" : options.link_folder + "/" + bus.name));
}

void World::tell_places() {
  for (std::size_t i = 0; i < lines_.size(); ++i) {
    const std::string place = ends_[i]->place();
    if (place == lines_[i].place) continue;
    lines_[i].place = place;
    say_(lines_[i].name + " " + lines_[i].kind + " " + (place.empty() ? "unplugged" : place));
  }
}

Result<> World::check(const FaultRequest& order) const {
  if (Result<> known = devices_->check(order); !known) return known;
  if (order.kind != Kind::unplug) return done();
  for (const Line& line : lines_)
    if (line.in_kernel && is_meant(order.bus, line.name))
      return Error{"bus '" + line.name + "' is an interface of the kernel; use: ip link set " + line.name + " down"};
  return done();
}

Result<> World::handle(const FaultRequest& order, std::int64_t now_ns) {
  if (Result<> sound = check(order); !sound) return sound;
  if (order.after_s > 0) {
    due_.push_back({now_ns + ns_of(order.after_s), order});
    due_.back().order.after_s = 0;
    return done();
  }
  act(order, now_ns);
  const bool momentary = order.kind == Kind::injected && (order.injected == hal::InjectedFault::power_loss ||
                                                          order.injected == hal::InjectedFault::watchdog_trip);
  const bool ends = !momentary && order.kind != Kind::unplug && order.kind != Kind::clear;
  if (ends && order.for_s > 0) due_.push_back({now_ns + ns_of(order.for_s), undone(order)});
  return done();
}

void World::act(const FaultRequest& order, std::int64_t now_ns) {
  if (order.kind == Kind::clear) due_.clear();
  if (order.kind != Kind::unplug) devices_->act(order, now_ns);
  constexpr double kMomentS = 1;
  for (std::size_t i = 0; i < lines_.size(); ++i) {
    if (!is_meant(order.bus, lines_[i].name)) continue;
    if (order.kind == Kind::bus_off) ends_[i]->set_bus_off(order.on);
    if (order.kind == Kind::clear) ends_[i]->set_bus_off(false);
    if (order.kind == Kind::unplug) ends_[i]->unplug(now_ns + ns_of(order.for_s > 0 ? order.for_s : kMomentS));
  }
  tell_places();
}

void World::tick(std::int64_t now_ns) {
  const auto due =
      std::stable_partition(due_.begin(), due_.end(), [&](const Due& each) { return each.at_ns > now_ns; });
  const std::vector<Due> now(due, due_.end());
  due_.erase(due, due_.end());
  for (const Due& each : now) static_cast<void>(handle(each.order, now_ns));  // it was checked on arrival
  for (const std::unique_ptr<End>& end : ends_) end->tick(now_ns);
  tell_places();
}

}  // namespace lithe::simulator
