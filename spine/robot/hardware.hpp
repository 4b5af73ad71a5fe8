// SPDX-License-Identifier: Apache-2.0
// What buses and devices demand of each other, whatever each of them says for itself.
#pragma once

#include "spine/robot/config.hpp"
#include "spine/robot/reader.hpp"

namespace lithe::robot {

// Complains where the last bus of `robot` is another one's hardware, or waits longer for answers than the robot may.
void check_bus(Reader& in, const RobotConfig& robot);
// Complains where the last device of `robot` cannot live beside those before it on its bus. `has_id`: its table says
// one.
void check_neighbours(Reader& in, const RobotConfig& robot, bool has_id);
// Complains where the device asks for what its bus or the robot's rate cannot give.
void check_device(Reader& in, const RobotConfig& robot, const DeviceConfig& device);
// Complains where the joint asks for what its device cannot do.
void check_joint(Reader& in, const RobotConfig& robot, const JointConfig& joint, const DeviceConfig& device);
// Complains where the last sensor of `robot` has no channel of its own on a gateway.
void check_sensor(Reader& in, const RobotConfig& robot);

}  // namespace lithe::robot
