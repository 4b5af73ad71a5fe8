// SPDX-License-Identifier: Apache-2.0
// A simulated CiA 402 drive of a robot file: what the registry's row needs of it.
#pragma once

#include <memory>

#include "spine/hal/bus/loop/loop_bus.hpp"
#include "spine/hal/physics/coupling.hpp"
#include "spine/hal/physics/sim_place.hpp"

namespace lithe::hal::sim {

std::unique_ptr<BusNode> make_sim_cia402(const SimPlace& place);
void couple_cia402(Coupling& coupling, BusNode& node);
double cia402_torque_max_nm(const robot::DeviceConfig& device);

}  // namespace lithe::hal::sim
