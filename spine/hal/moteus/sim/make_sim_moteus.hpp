// SPDX-License-Identifier: Apache-2.0
// A simulated moteus of a robot file: what the registry's row needs of it.
#pragma once

#include <memory>

#include "spine/hal/bus/loop/loop_bus.hpp"
#include "spine/hal/physics/coupling.hpp"
#include "spine/hal/physics/sim_place.hpp"

namespace lithe::hal::sim {

std::unique_ptr<BusNode> make_sim_moteus(const SimPlace& place);
void couple_moteus(Coupling& coupling, BusNode& node);
double moteus_torque_max_nm(const robot::DeviceConfig& device);

}  // namespace lithe::hal::sim
