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
      return "gateway";
    case DeviceKind::imu:
      break;
  }
  return "imu";
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
    if (other.kind != device.kind && is_drive(other.kind) && is_drive(device.kind)) {
      in.complain("bus", fmt::format("\"{}\" on it is a {}, this is a {}: their frames carry the same ids; give them "
                                     "a bus each",
                                     other.name, word(other.kind), word(device.kind)));
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
  if (device.kind == DeviceKind::imu && bus.kind != BusKind::pi3hat && bus.kind != BusKind::loop) {
    in.complain("bus", fmt::format("\"{}\" is of a kind that has no imu; name a bus of the pi3hat", bus.name));
  }
}

void check_sensor(Reader& in, const RobotConfig& robot) {
  const SensorConfig& sensor = robot.sensors.back();
  if (sensor.device >= robot.devices.size()) return;
  const DeviceConfig& device = robot.devices[sensor.device];
  if (is_drive(device.kind)) {
    in.complain("device",
                fmt::format("\"{}\" is a {}; sensors hang on a gateway or an imu", device.name, word(device.kind)));
  }
  constexpr std::uint32_t kImuChannels = 10;  // attitude w x y z, angular rate x y z, acceleration x y z
  if (device.kind == DeviceKind::imu && (sensor.kind != SensorKind::imu || sensor.channel >= kImuChannels)) {
    in.complain("channel", "an imu has kind = \"imu\" with the channels 0 to 9: attitude w x y z, rate, acceleration");
  }
  for (std::size_t i = 0; i + 1 < robot.sensors.size(); ++i) {
    const SensorConfig& other = robot.sensors[i];
    if (other.device == sensor.device && other.kind == sensor.kind && other.channel == sensor.channel) {
      in.complain("channel", fmt::format("{} is \"{}\" already", sensor.channel, other.name));
    }
  }
}

}  // namespace lithe::robot
