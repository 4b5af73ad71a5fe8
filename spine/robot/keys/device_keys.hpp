// SPDX-License-Identifier: Apache-2.0
// Keys of a [[device]] that only one kind has, and checks of a joint that depend on the kind of its drive.
#pragma once

#include "spine/robot/config.hpp"
#include "spine/robot/read/reader.hpp"

namespace lithe::robot {

// `need`: of keys without a default.
void read_keys(Reader& in, DeviceConfig& device, Need need);
// Error when the joint needs what its device cannot do.
void check_joint(Reader& in, const RobotConfig& robot, const JointConfig& joint, const DeviceConfig& device);

}  // namespace lithe::robot
