// SPDX-License-Identifier: Apache-2.0
// From a robot file's words to the simulated devices at the far end of its buses.
#pragma once

#include <cstddef>
#include <memory>
#include <vector>

#include "spine/core/result.hpp"
#include "spine/core/rt.hpp"
#include "spine/hal/bus/loop/loop_bus.hpp"
#include "spine/hal/physics/coupling.hpp"
#include "spine/robot/config.hpp"

namespace lithe::hal::sim {

// All devices of one robot, each with the plant of the joint that it moves; a drive that moves none turns freely.
struct Nodes {
  std::vector<std::unique_ptr<BusNode>> devices;  // as RobotConfig::devices
  std::unique_ptr<Coupling> coupling;             // what all joints move together; null: each swings by itself

  // Every joint is where it began, at rest.
  // Contract: RT
  void to_start() LITHE_RT {
    if (coupling != nullptr) coupling->to_start();
    for (const auto& device : devices) device->to_start();
  }

  // To anything that devices can be attached to, those of one bus.
  // Contract: never in the tick
  template <class AnyBus>
  void attach(const robot::RobotConfig& config, std::size_t bus, AnyBus& to) const {
    if (coupling != nullptr) to.attach(*coupling);
    for (std::size_t i = 0; i < devices.size(); ++i) {
      if (config.devices[i].bus == bus) to.attach(*devices[i]);
    }
  }
};

// The error: what the joints are to move cannot be had.
// Contract: never in the tick
Result<Nodes> make_nodes(const robot::RobotConfig& config);

// One more of the devices, whose joint swings by itself whatever the others move together: what stands in another's
// place on a bus.
// Contract: never in the tick
std::unique_ptr<BusNode> make_stranger(const robot::RobotConfig& config, std::size_t device);

}  // namespace lithe::hal::sim
