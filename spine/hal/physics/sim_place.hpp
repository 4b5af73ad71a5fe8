// SPDX-License-Identifier: Apache-2.0
// What a simulated device is made from.
#pragma once

#include <cstddef>
#include <memory>

#include "spine/hal/bus/loop/loop_bus.hpp"
#include "spine/hal/core/drive.hpp"
#include "spine/hal/physics/coupled_drive.hpp"
#include "spine/hal/physics/plant.hpp"
#include "spine/hal/physics/truth.hpp"
#include "spine/robot/config.hpp"

namespace lithe::hal::sim {

// A simulated device at the far end of a bus.
struct SimDevice {
  std::unique_ptr<BusNode> node;
  CoupledDrive* drive = nullptr;  // of the node; null: it moves nothing
};

// One device of a robot, and what its motor moves. A device that measures has no use for the lower four.
struct SimPlace {
  const robot::DeviceConfig& device;
  const robot::BusConfig& bus;
  std::size_t index = 0;  // of the device in its robot
  std::uint32_t encoder_counts = 0;
  JointTransform joint{};
  PlantParams plant{};
  DriveErrors errors{};
};

}  // namespace lithe::hal::sim
