// SPDX-License-Identifier: Apache-2.0
#include "sim/devices.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "spine/hal/sim/simulate.hpp"

namespace lithe::simulator {
namespace {

using hal::InjectedFault;
using Kind = FaultRequest::Kind;

// False for faults that this kind of device does not have.
bool has_fault(robot::DeviceKind device, const FaultRequest& order) {
  if (order.kind != Kind::injected) return robot::facts(device).on_bus;  // twin, wrong id
  return (hal::sim::type_of(device).injected & hal::sim::bit_of(order.injected)) != 0;
}

constexpr std::uint32_t kIds = 126;

}  // namespace

Result<std::unique_ptr<Devices>> Devices::make(const robot::RobotConfig& config, std::uint64_t seed) {
  Result<hal::sim::Nodes> nodes = hal::sim::make_nodes(config);
  if (!nodes) return nodes.error();
  auto made = std::make_unique<Devices>();
  made->config_ = config;
  made->nodes_ = std::move(*nodes);
  made->second_.resize(config.devices.size());
  for (std::size_t i = 0; i < config.buses.size(); ++i) {
    made->wires_.push_back(std::make_unique<hal::sim::SimWire>(seed + i));
    made->nodes_.attach(config, i, *made->wires_.back());
  }
  return made;
}

Result<> Devices::check(const FaultRequest& order) const {
  const auto named = [](const auto& all, const std::string& name) {
    return name.empty() || std::any_of(all.begin(), all.end(), [&](const auto& each) { return each.name == name; });
  };
  if (!named(config_.buses, order.bus)) return Error{"there is no bus '" + order.bus + "' in the robot file"};
  if (!named(config_.devices, order.device))
    return Error{"there is no device '" + order.device + "' in the robot file"};
  const auto can_have = [&](const robot::DeviceConfig& device) {
    return (order.device.empty() || order.device == device.name) && has_fault(device.kind, order);
  };
  if (is_of_device(order.kind) && std::none_of(config_.devices.begin(), config_.devices.end(), can_have))
    return Error{"such a thing cannot happen to " + (order.device.empty() ? "any device here" : order.device)};
  return done();
}

void Devices::act(const FaultRequest& order, std::int64_t now_ns) {
  if (order.kind == Kind::clear) return clear(now_ns);
  if (!is_of_device(order.kind)) {
    for (std::size_t i = 0; i < wires_.size(); ++i)
      if (order.bus.empty() || order.bus == config_.buses[i].name) set_wire_fault(order, i);
    return;
  }
  for (std::size_t i = 0; i < config_.devices.size(); ++i) {
    const robot::DeviceConfig& device = config_.devices[i];
    if ((order.device.empty() || order.device == device.name) && has_fault(device.kind, order)) {
      if (order.kind == Kind::injected)
        nodes_.devices[i].node->inject(order.injected, order.on, now_ns);
      else
        set_second_device(i, order);
    }
  }
}

// twin: a second device with the same id and another position. wrong_id: a device with another id replaces the right
// one.
void Devices::set_second_device(std::size_t index, const FaultRequest& order) {
  hal::BusNode& device = *nodes_.devices[index].node;
  SecondDevice& other_device = second_[index];
  hal::sim::SimWire& wire = *wires_[config_.devices[index].bus];
  if (other_device.second != nullptr) wire.detach(*other_device.second);
  other_device.second.reset();
  if (!other_device.here) wire.attach(device);
  other_device.here = true;
  if (!order.on) return;
  robot::RobotConfig other = config_;
  constexpr double kElsewhereRad = 0.3;
  for (robot::JointConfig& joint : other.joints)
    if (joint.device == index) joint.sim.initial_position_rad += kElsewhereRad;
  if (order.kind == Kind::wrong_id) {
    std::uint32_t& id = other.devices[index].id;
    id = (id + kIds / 2 - 1) % kIds + 1;
    other_device.here = false;
    wire.detach(device);
  }
  other_device.second = hal::sim::make_second_device(other, index);
  wire.attach(*other_device.second);
}

void Devices::set_wire_fault(const FaultRequest& order, std::size_t bus) {
  hal::sim::WireFaults faults = wires_[bus]->faults();
  if (order.kind == Kind::drop) faults.drop = order.amount;
  if (order.kind == Kind::corrupt) faults.corrupt = order.amount;
  if (order.kind == Kind::duplicate) faults.duplicate = order.amount;
  if (order.kind == Kind::replay) faults.replay = order.amount;
  if (order.kind == Kind::delay) faults.delay_ns = std::llround(1e9 * order.amount);
  if (order.kind == Kind::bus_off) faults.bus_off = order.on;
  wires_[bus]->set_faults(faults);
}

void Devices::clear(std::int64_t now_ns) {
  FaultRequest over;
  over.on = false;
  for (const auto& wire : wires_) wire->set_faults({});
  for (std::size_t i = 0; i < nodes_.devices.size(); ++i) {
    if (nodes_.devices[i].node == nullptr) continue;
    using enum InjectedFault;
    for (const InjectedFault injected : {over_temperature, encoder_lost, device_fault, homing_lost, other_map})
      nodes_.devices[i].node->inject(injected, false, now_ns);
    if (second_[i].second != nullptr) set_second_device(i, over);
  }
}

}  // namespace lithe::simulator
