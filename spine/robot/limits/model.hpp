// SPDX-License-Identifier: Apache-2.0
// What the guard needs of a robot's rigid-body model: the tree, and the decelerations that all joints can have at once.
#pragma once

#include "spine/mechanics/tree.hpp"
#include "spine/robot/config.hpp"
#include "spine/robot/read/reader.hpp"

namespace lithe::robot {

// Of torque_max_nm: what a brake may use. The rest is kept for friction and noise.
inline constexpr double kUsableTorque = 0.95;

// Contract: never in the tick · the robot has a [model]
mechanics::Tree tree_of(const RobotConfig& robot);

// To be called when all joints are read: allots decelerations and the most gain of the drives' own PD, or reports what
// is missing. A deceleration is allotted for the worst of 200 poses and all directions at once. Reported: a joint
// without a model, a drive with a rate_divider or with a loop of its own, links without inertia, a pose in which
// gravity leaves a joint no torque to slow down with.
// Contract: never in the tick
void settle_model(Reader& top, RobotConfig& robot);

}  // namespace lithe::robot
