// SPDX-License-Identifier: Apache-2.0
// What simulated joints move: the section [plant], and each joint's sim. Which keys there are depends on the plant's
// kind.
#pragma once

#include "spine/robot/config.hpp"
#include "spine/robot/reader.hpp"

namespace lithe::robot {

void read_mechanism(Reader& in, MechanismConfig& plant);
void read_plant(Reader& in, PlantConfig& sim, PlantKind kind);

// Of a chain. forget_link before the first key is read, settle_link after the last: a link must say its length and its
// mass; where it leaves out its centre or its inertia, it is a thin rod.
void forget_link(PlantConfig& sim);
void settle_link(Reader& joint, PlantConfig& sim);

}  // namespace lithe::robot
