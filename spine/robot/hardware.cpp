// SPDX-License-Identifier: Apache-2.0
#include "spine/robot/hardware.hpp"

#include <fmt/format.h>

namespace lithe::robot {
namespace {

std::string_view word(DeviceKind kind) {
  switch (kind) {
    case DeviceKind::moteus:
      return "moteus";
    case DeviceKind::cia402:
      return "cia402";
    case DeviceKind::gateway:
      break;
  }
  return "gateway";
}

}  // namespace

void check_neighbours(Reader& in, const RobotConfig& robot, bool has_id) {
  const DeviceConfig& device = robot.devices.back();
  for (std::size_t i = 0; i + 1 < robot.devices.size(); ++i) {
    const DeviceConfig& other = robot.devices[i];
    if (other.bus != device.bus) continue;
    if (has_id && other.id == device.id) {
      in.complain("id", fmt::format("{} is already taken on this bus by \"{}\"", device.id, other.name));
    }
    if (other.kind != device.kind && other.kind != DeviceKind::gateway && device.kind != DeviceKind::gateway) {
      in.complain("bus", fmt::format("\"{}\" on it is a {}, this is a {}: their frames carry the same ids; give them "
                                     "a bus each",
                                     other.name, word(other.kind), word(device.kind)));
      return;
    }
    const bool together = device.kind == DeviceKind::cia402 && other.kind == DeviceKind::cia402;
    if (together && other.rate_divider != device.rate_divider) {
      in.complain("rate_divider", fmt::format("{} is not {} as of \"{}\": one SYNC is for all CANopen drives of a bus; "
                                              "give them the same, or a bus each",
                                              device.rate_divider, other.rate_divider, other.name));
      return;
    }
  }
}

void check_device(Reader& in, const RobotConfig& robot, const DeviceConfig& device) {
  const double asked_hz = robot.rate_hz / device.rate_divider;
  if (device.watchdog_s * asked_hz < 4.0) {
    in.complain("watchdog_s", fmt::format("{} s is less than 4 {} at {} Hz, the device would stop by itself; "
                                          "give at least {}",
                                          device.watchdog_s, device.rate_divider == 1 ? "ticks" : "commands", asked_hz,
                                          4.0 / asked_hz));
  }
  if (device.bus >= robot.buses.size()) return;
  const BusConfig& bus = robot.buses[device.bus];
  if (device.kind == DeviceKind::moteus && !is_fd(bus)) {
    in.complain("bus", fmt::format("\"{}\" carries classic CAN only, a moteus speaks CAN FD; give the bus a "
                                   "data_bitrate, if its adapter can, or use another bus",
                                   bus.name));
  }
  if (device.kind == DeviceKind::cia402 && bus.kind == BusKind::fdcanusb) {
    in.complain("bus", fmt::format("\"{}\" is an fdcanusb, which sends CAN FD; CANopen drives speak classic CAN: use "
                                   "slcan or socketcan",
                                   bus.name));
  }
}

void check_joint(Reader& in, const JointConfig& joint, const DeviceConfig& device) {
  if (device.kind != DeviceKind::cia402) return;
  if (joint.must_be_homed) {
    in.complain("must_be_homed", fmt::format("\"{}\" is a cia402 drive, which does not tell whether it is homed: say "
                                             "false, and home the drive before the robot is armed",
                                             device.name));
  }
  if (joint.power_max_w > 0 && device.mode != DriveMode::torque) {
    in.complain("power_max_w", fmt::format("\"{}\" closes its own loop (mode), so nobody here bounds its power: say 0, "
                                           "or use mode = \"torque\"",
                                           device.name));
  }
}

void check_sensor(Reader& in, const RobotConfig& robot) {
  const SensorConfig& sensor = robot.sensors.back();
  if (sensor.device >= robot.devices.size()) return;
  const DeviceConfig& device = robot.devices[sensor.device];
  if (device.kind != DeviceKind::gateway) {
    in.complain("device", fmt::format("\"{}\" is a {}; sensors hang on a gateway", device.name, word(device.kind)));
  }
  for (std::size_t i = 0; i + 1 < robot.sensors.size(); ++i) {
    const SensorConfig& other = robot.sensors[i];
    if (other.device == sensor.device && other.kind == sensor.kind && other.channel == sensor.channel) {
      in.complain("channel", fmt::format("{} is \"{}\" already", sensor.channel, other.name));
    }
  }
}

}  // namespace lithe::robot
