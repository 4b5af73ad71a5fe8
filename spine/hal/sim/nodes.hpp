// SPDX-License-Identifier: Apache-2.0
// Makes the simulated devices of a robot file.
#pragma once

#include <cstddef>
#include <memory>
#include <vector>

#include "spine/core/result.hpp"
#include "spine/core/rt.hpp"
#include "spine/hal/bus/loop/loop_bus.hpp"
#include "spine/hal/physics/coupling.hpp"
#include "spine/hal/physics/sim_place.hpp"
#include "spine/robot/config.hpp"

namespace lithe::hal::sim {

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
// Contract: never in the tick
Result<Nodes> make_nodes(const robot::RobotConfig& config);

// Makes one more device with an independent joint, to replace or duplicate a device on a bus.
// Contract: never in the tick
std::unique_ptr<BusNode> make_second_device(const robot::RobotConfig& config, std::size_t device);

}  // namespace lithe::hal::sim
