// SPDX-License-Identifier: Apache-2.0
// Checks of buses, devices, joints and sensors against each other.
#pragma once

#include "spine/robot/config.hpp"
#include "spine/robot/read/reader.hpp"

namespace lithe::robot {

// Error when the last bus of `robot` uses the hardware of another bus, or its reply_wait_s is too long for the rate.
void check_bus(Reader& in, const RobotConfig& robot);
// Error when the last device of `robot` conflicts with earlier devices of its bus. `has_id`: its table has the key
// `id`.
void check_neighbours(Reader& in, const RobotConfig& robot, bool has_id);
// Error when the device needs what its bus, or the robot's rate, does not offer.
void check_device(Reader& in, const RobotConfig& robot, const DeviceConfig& device);
// Error when the joint needs what its drive cannot do.
void check_joint(Reader& in, const RobotConfig& robot, const JointConfig& joint, const DeviceConfig& device);
// Error when the last sensor of `robot` shares its channel, or the device has no such channel.
void check_sensor(Reader& in, const RobotConfig& robot);

}  // namespace lithe::robot
