// SPDX-License-Identifier: Apache-2.0
// The guard's model of a joint: worst load, inertia, delay. Fills in what the robot file leaves out, and checks whether
// the guard can keep the limits with it.
#pragma once

#include <string>

#include "spine/robot/config.hpp"
#include "spine/robot/read/reader.hpp"

namespace lithe::robot {

// To be called before the keys of a joint are read: marks load, inertia and delay as not given.
void forget_limits(JointConfig& joint);

// Whether the robot file's simulation contains every load on this joint. Not in a chain or a model, where other joints
// pull at it, and not behind a real bus.
bool is_simulated(const RobotConfig& robot, const JointConfig& joint);

// To be called after the keys. Fills in what was not given; reports limits that cannot be kept. The notes name assumed
// values, and limits that are kept only at a lower speed.
// Contract: never in the tick · the joint's device is known
void settle_limits(Reader& in, RobotConfig& robot, JointConfig& joint);

// Why the joint does not stop inside its range from its top speed, and the values that alone would change it, as a user
// reads it; "" when it does.
std::string way_advice(const RobotConfig& robot, const JointConfig& joint);

// Whether the safe law's gains leave enough phase margin at the joint's least inertia (stopping.hpp).
bool safe_gains_fit(const RobotConfig& robot, const JointConfig& joint);

}  // namespace lithe::robot
