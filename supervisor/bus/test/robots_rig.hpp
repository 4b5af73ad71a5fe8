// SPDX-License-Identifier: Apache-2.0
// Robots for the tests of the planner and its advice.
#pragma once

#include <string>

#include "spine/robot/config.hpp"

namespace lithe::bus::test {

using robot::BusKind;
using robot::DeviceKind;
using robot::RobotConfig;

inline std::size_t add_bus(RobotConfig& robot, BusKind kind = BusKind::socketcan) {
  robot::BusConfig bus;
  bus.name = "can" + std::to_string(robot.buses.size());
  bus.kind = kind;
  bus.connector = static_cast<std::uint32_t>(robot.buses.size() + 1);
  robot.buses.push_back(bus);
  return robot.buses.size() - 1;
}

inline robot::DeviceConfig& add(RobotConfig& robot, std::size_t bus, DeviceKind kind = DeviceKind::moteus) {
  robot::DeviceConfig device;
  device.bus = bus;
  device.kind = kind;
  device.id = 1;
  for (const auto& other : robot.devices) device.id += other.bus == bus ? 1 : 0;
  device.name = robot.buses[bus].name + "." + std::to_string(device.id);
  robot.devices.push_back(device);
  robot::JointConfig joint;
  joint.device = robot.devices.size() - 1;
  if (kind != DeviceKind::gateway) robot.joints.push_back(joint);
  return robot.devices.back();
}

inline RobotConfig moteus_robot(int drives, BusKind kind = BusKind::socketcan) {
  RobotConfig robot;
  robot.path = "r.toml";
  const std::size_t bus = add_bus(robot, kind);
  for (int i = 0; i < drives; ++i) add(robot, bus);
  return robot;
}

inline RobotConfig canopen_robot(int drives, double rate_hz) {
  RobotConfig robot;
  robot.rate_hz = rate_hz;
  const std::size_t bus = add_bus(robot);
  robot.buses[bus].data_bitrate = 0;
  for (int i = 0; i < drives; ++i) add(robot, bus, DeviceKind::cia402).keys.cia402.mode = hal::cia402::Mode::position;
  return robot;
}

}  // namespace lithe::bus::test
