// SPDX-License-Identifier: Apache-2.0
#include "sim/world.hpp"

#include <algorithm>
#include <cmath>
#include <filesystem>

#include "spine/hal/sim/sim_fdcanusb.hpp"
#include "spine/hal/sim/sim_slcan.hpp"

namespace lithe::simulator {
namespace {

using robot::BusKind;
using Kind = Order::Kind;

bool is_of_device(Kind kind) { return kind == Kind::reset || kind == Kind::over_temperature || kind == Kind::encoder; }

hal::Mishap mishap_of(Kind kind) {
  if (kind == Kind::reset) return hal::Mishap::power_loss;
  return kind == Kind::encoder ? hal::Mishap::encoder_lost : hal::Mishap::over_temperature;
}

// An order names one bus or device, or none: then it is for all.
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
  world->config_ = config;
  Result<hal::sim::Nodes> made = hal::sim::make_nodes(config);
  if (!made) return Error{config.path + ": " + made.message()};
  world->nodes_ = std::move(*made);
  for (std::size_t i = 0; i < config.buses.size(); ++i) {
    if (Result<> added = world->add_bus(i, options); !added) return added.error();
  }
  world->tell_places();
  return world;
}

// A bus in memory and one of a board that is not here have no far end of their own: an adapter takes their place.
Result<> World::add_bus(std::size_t index, const Options& options) {
  const robot::BusConfig& bus = config_.buses[index];
  auto wire = std::make_unique<hal::sim::SimWire>(options.seed + index);
  nodes_.attach(config_, index, *wire);
  std::string kind = bus.kind == BusKind::slcan ? "slcan" : "fdcanusb";
  if (bus.kind == BusKind::socketcan) {
    kind = "socketcan";
    auto end =
        CanEnd::open({.interface = bus.interface, .bitrate = bus.bitrate, .data_bitrate = bus.data_bitrate}, *wire);
    if (!end) return Error{"bus '" + bus.name + "': " + end.message()};
    ends_.push_back(std::move(*end));
  } else {
    std::unique_ptr<hal::sim::SimAdapter> adapter;
    if (bus.kind == BusKind::slcan) {
      adapter = std::make_unique<hal::sim::SimSlcan>();
    } else {
      adapter = std::make_unique<hal::sim::SimFdcanusb>();
    }
    adapter->attach(*wire);
    const std::string link = options.link_folder.empty() ? "" : options.link_folder + "/" + bus.name;
    auto end = PtyEnd::open(std::move(adapter), link);
    if (!end) return Error{"bus '" + bus.name + "': " + end.message()};
    ends_.push_back(std::move(*end));
  }
  lines_.push_back({bus.name, kind, std::move(wire), ""});
  return done();
}

void World::tell_places() {
  for (std::size_t i = 0; i < lines_.size(); ++i) {
    const std::string place = ends_[i]->place();
    if (place == lines_[i].place) continue;
    lines_[i].place = place;
    say_(lines_[i].name + " " + lines_[i].kind + " " + (place.empty() ? "unplugged" : place));
  }
}

Result<> World::check(const Order& order) const {
  const auto named = [](const auto& all, const std::string& name) {
    return name.empty() || std::any_of(all.begin(), all.end(), [&](const auto& each) { return each.name == name; });
  };
  if (!named(lines_, order.bus)) return Error{"there is no bus '" + order.bus + "' in the robot file"};
  if (!named(config_.devices, order.device)) {
    return Error{"there is no device '" + order.device + "' in the robot file"};
  }
  const auto suffers = [&](const robot::DeviceConfig& each) {
    return robot::is_drive(each.kind) && is_meant(order.device, each.name);
  };
  if (is_of_device(order.kind) && std::none_of(config_.devices.begin(), config_.devices.end(), suffers)) {
    return Error{"such a thing cannot happen to " + (order.device.empty() ? "any device here" : order.device)};
  }
  if (order.kind != Kind::unplug) return done();
  for (const Line& line : lines_) {
    if (line.kind == "socketcan" && is_meant(order.bus, line.name)) {
      return Error{"bus '" + line.name + "' is an interface of the kernel; use: ip link set " + line.name + " down"};
    }
  }
  return done();
}

Result<> World::obey(const Order& order, std::int64_t now_ns) {
  if (Result<> sound = check(order); !sound) return sound;
  if (order.after_s > 0) {
    due_.push_back({now_ns + ns_of(order.after_s), order});
    due_.back().order.after_s = 0;
    return done();
  }
  act(order, now_ns);
  const bool ends = order.kind != Kind::unplug && order.kind != Kind::reset && order.kind != Kind::clear;
  if (ends && order.for_s > 0) due_.push_back({now_ns + ns_of(order.for_s), undone(order)});
  return done();
}

void World::act(const Order& order, std::int64_t now_ns) {
  if (order.kind == Kind::clear) {
    clear(now_ns);
    return;
  }
  if (is_of_device(order.kind)) {
    for (std::size_t i = 0; i < nodes_.devices.size(); ++i) {
      if (!is_meant(order.device, config_.devices[i].name)) continue;
      nodes_.devices[i]->befall(mishap_of(order.kind), order.on, now_ns);
    }
    return;
  }
  for (std::size_t i = 0; i < lines_.size(); ++i) {
    if (is_meant(order.bus, lines_[i].name)) act_on_bus(order, i, now_ns);
  }
}

void World::act_on_bus(const Order& order, std::size_t bus, std::int64_t now_ns) {
  hal::sim::WireFaults faults = lines_[bus].wire->faults();
  switch (order.kind) {
    case Kind::drop:
      faults.drop = order.amount;
      break;
    case Kind::corrupt:
      faults.corrupt = order.amount;
      break;
    case Kind::duplicate:
      faults.duplicate = order.amount;
      break;
    case Kind::delay:
      faults.delay_ns = ns_of(order.amount);
      break;
    case Kind::bus_off:
      faults.bus_off = order.on;
      ends_[bus]->spoil_wires(order.on);
      break;
    default: {
      constexpr double kMomentS = 1;
      ends_[bus]->unplug(now_ns + ns_of(order.for_s > 0 ? order.for_s : kMomentS));
      return tell_places();
    }
  }
  lines_[bus].wire->set_faults(faults);
}

void World::clear(std::int64_t now_ns) {
  due_.clear();
  for (const Line& line : lines_) line.wire->set_faults({});
  for (const std::unique_ptr<End>& end : ends_) end->spoil_wires(false);
  for (const auto& device : nodes_.devices) {
    for (const hal::Mishap mishap : {hal::Mishap::over_temperature, hal::Mishap::encoder_lost}) {
      device->befall(mishap, false, now_ns);
    }
  }
}

void World::tick(std::int64_t now_ns) {
  std::vector<Due> now;
  for (std::size_t i = 0; i < due_.size();) {
    if (due_[i].at_ns > now_ns) {
      ++i;
      continue;
    }
    now.push_back(due_[i]);
    due_.erase(due_.begin() + static_cast<std::ptrdiff_t>(i));
  }
  for (const Due& each : now) static_cast<void>(obey(each.order, now_ns));  // it was checked when it came
  for (const std::unique_ptr<End>& end : ends_) end->tick(now_ns);
  tell_places();
}

}  // namespace lithe::simulator
