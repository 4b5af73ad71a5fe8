// SPDX-License-Identifier: Apache-2.0
// The simulated side of each kind of device, one row each, and the adapters of simulated buses. The drivers' rows are
// in spine/hal/registry.hpp.
#pragma once

#include <cstdint>
#include <memory>
#include <string_view>

#include "spine/hal/bus/serial/sim_adapter.hpp"
#include "spine/hal/physics/sim_place.hpp"
#include "spine/robot/config.hpp"

namespace lithe::hal::sim {

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
// A kind without a row, one that is in memory or on a board that is not here, is offered as an fdcanusb.
const SimBusType& type_of(robot::BusKind kind);

}  // namespace lithe::hal::sim
