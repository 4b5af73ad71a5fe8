// SPDX-License-Identifier: Apache-2.0
// Makes the simulated devices of a robot file, and its Actuators with them.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string_view>
#include <vector>

#include "spine/core/result.hpp"
#include "spine/core/rt.hpp"
#include "spine/hal/actuators.hpp"
#include "spine/hal/bus/loop/loop_bus.hpp"
#include "spine/hal/bus/serial/sim_adapter.hpp"
#include "spine/hal/physics/coupled_drive.hpp"
#include "spine/hal/physics/coupling.hpp"
#include "spine/hal/robot_hardware.hpp"
#include "spine/robot/config.hpp"

namespace lithe::hal::sim {

// The simulated side of each kind of device and the adapters of simulated buses, one row each in sim_registry.cpp. The
// drivers' rows are in spine/hal/registry.hpp.
//
// A null function: the kind has no such thing.
struct SimDeviceType {
  robot::DeviceKind kind;
  SimDevice (*make)(const SimPlace&) = nullptr;
  double (*motor_torque_max_nm)(const robot::DeviceConfig&) = nullptr;
  std::uint32_t injected = 0;  // bits `bit_of` of the faults that it knows
};

// What `lithe sim` offers a bus as. Null: an interface of the kernel.
struct SimBusType {
  robot::BusKind kind;
  std::string_view adapter{};
  std::unique_ptr<SimAdapter> (*make_adapter)() = nullptr;
};

constexpr std::uint32_t bit_of(InjectedFault injected) { return 1U << static_cast<unsigned>(injected); }

const SimDeviceType& type_of(robot::DeviceKind kind);
// A kind without a row, one that is in memory or on a board that is not here, is offered as the first row says.
const SimBusType& type_of(robot::BusKind kind);

// All devices of one robot, each with the plant of its joint; a drive without a joint turns freely.
struct Nodes {
  std::vector<SimDevice> devices;      // as RobotConfig::devices; without a node: on no bus
  std::unique_ptr<Coupling> coupling;  // couples all joints; null = independent joints

  // Puts every joint back to its start, at rest.
  // Contract: RT
  void to_start() LITHE_RT {
    if (coupling != nullptr) coupling->to_start();
    for (const SimDevice& device : devices)
      if (device.node != nullptr) device.node->to_start();
  }

  // Attaches the devices of one bus.
  // Contract: never in the tick
  template <class AnyBus>
  void attach(const robot::RobotConfig& config, std::size_t bus, AnyBus& to) const {
    if (coupling != nullptr) to.attach(*coupling);
    for (std::size_t i = 0; i < devices.size(); ++i)
      if (config.devices[i].bus == bus && devices[i].node != nullptr) to.attach(*devices[i].node);
  }
};

// The error: the plant cannot be opened.
// Contract: this and the functions below never in the tick
Result<Nodes> make_nodes(const robot::RobotConfig& config);

// Makes one more device with an independent joint, to replace or duplicate a device on a bus.
std::unique_ptr<BusNode> make_second_device(const robot::RobotConfig& config, std::size_t device);

// The simulated devices of a robot file. The error: the plant cannot be opened, or it joins simulated and real joints.
Result<std::unique_ptr<Simulation>> make_simulation(const robot::RobotConfig& config);

// As hal::open_actuators; buses of kind "loop" have simulated devices.
Result<std::unique_ptr<Actuators>> open_actuators(const robot::RobotConfig& config, FrameTap* tap = nullptr);

// The same robot with every bus and device simulated, whatever the file says.
Result<std::unique_ptr<Actuators>> simulate_actuators(robot::RobotConfig config);

}  // namespace lithe::hal::sim
