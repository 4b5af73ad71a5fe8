// SPDX-License-Identifier: Apache-2.0
// Each section of robot.toml: its keys, their ranges and where they go. A new key is one line here, one in config.hpp.
#pragma once

#include <string_view>
#include <vector>

#include "spine/robot/config.hpp"
#include "spine/robot/read/reader.hpp"

namespace lithe::robot {

inline constexpr double kBig = 1.0e6;  // the end of the range of a key that has no other

void read_spine(Reader& in, SpineConfig& spine);
void read_guard(Reader& in, GuardConfig& guard);
void read_brain(Reader& in, BrainConfig& brain);
void read_swap(Reader& in, SwapConfig& swap);
void read_sensor(Reader& in, SensorConfig& sensor, const std::vector<std::string_view>& devices);

// False: its kind is none that is known; no other key was read, because what they mean depends on it.
bool read_bus(Reader& in, BusConfig& bus, double rate_hz);

// The keys that [defaults] may contain; there `need` is optional. Name, id and device cannot have a default. A device's
// kind is not known: as for a bus.
bool read_device(Reader& in, DeviceConfig& device, const std::vector<std::string_view>& buses, Need need);
void read_joint(Reader& in, JointConfig& joint, Need need);

// [plant] and each joint's `sim` (plants.cpp). The allowed keys depend on the plant's kind.
void read_mechanism(Reader& in, MechanismConfig& plant);
void read_plant(Reader& in, PlantConfig& sim, PlantKind kind);

// [model] and [joint.model] (model.cpp). The joint is the last of `robot`.
void read_model(Reader& in, ModelConfig& model);
void read_joint_model(Reader& in, const RobotConfig& robot, JointModel& model);

// Of a chain. forget_link before the first key is read, settle_link after the last: length and mass are required;
// without centre or inertia the link is a thin rod.
void forget_link(PlantConfig& sim);
void settle_link(Reader& joint, PlantConfig& sim);

// Checks of buses, devices, joints and sensors against each other (hardware.cpp): error when the last bus of `robot`
// uses the hardware of another bus, or its reply_wait_s is too long for the rate.
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
