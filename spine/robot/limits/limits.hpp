// SPDX-License-Identifier: Apache-2.0
// What the guard reckons with to keep a joint inside its limits: the worst load, the inertia, the delay. Completed
// where the robot file says nothing, and checked against the limits it shall keep.
#pragma once

#include "spine/robot/config.hpp"
#include "spine/robot/read/reader.hpp"

namespace lithe::robot {

// Before the keys of a joint are read: nothing of the above has been said.
void forget_limits(JointConfig& joint);

// Whether the robot file's simulation says all that pulls at the joint: in a chain or a model the other joints do too,
// and behind a real bus there is a real joint.
bool is_simulated(const RobotConfig& robot, const JointConfig& joint);

// After them. Fills in what was not said and complains about what cannot work; the notes say what the guard reckons
// with where nobody declared it, and which limits it can keep only by being slower.
// Contract: never in the tick · the joint's device is known
void settle_limits(Reader& in, RobotConfig& robot, JointConfig& joint);

}  // namespace lithe::robot
