// SPDX-License-Identifier: Apache-2.0
// Reads [plant] and each joint's `sim`. The allowed keys depend on the plant's kind.
#pragma once

#include "spine/robot/config.hpp"
#include "spine/robot/read/reader.hpp"

namespace lithe::robot {

void read_mechanism(Reader& in, MechanismConfig& plant);
void read_plant(Reader& in, PlantConfig& sim, PlantKind kind);

// Of a chain. forget_link before the first key is read, settle_link after the last: length and mass are required;
// without centre or inertia the link is a thin rod.
void forget_link(PlantConfig& sim);
void settle_link(Reader& joint, PlantConfig& sim);

}  // namespace lithe::robot
