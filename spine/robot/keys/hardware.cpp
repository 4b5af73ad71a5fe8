// SPDX-License-Identifier: Apache-2.0
#include "spine/robot/keys/sections.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <numbers>
#include <string>

namespace lithe::robot {
namespace {

// Identity of the hardware: buses with the same name share it. Empty = not shared.
std::string hardware_of(const BusConfig& bus) {
  const PlaceKey place = facts(bus.kind).place;
  if (place == PlaceKey::interface) return bus.interface;
  if (place == PlaceKey::connector) return fmt::format("JC{}", bus.connector);
  if (place == PlaceKey::none) return "";
  std::error_code wrong;
  const std::filesystem::path real = std::filesystem::weakly_canonical(bus.path, wrong);
  return wrong ? bus.path : real.string();
}

// The longest exchange: all buses wait until the last answer has come.
double longest_wait_s(const RobotConfig& robot) {
  double longest_s = 0;
  for (const BusConfig& bus : robot.buses)
    if (is_real(bus)) longest_s = std::max(longest_s, bus.reply_wait_s);
  return longest_s;
}

// "a gateway or an imu".
std::string what_measures() {
  std::string words, last;
  for (const DeviceFacts& kind : kDeviceFacts) {
    if (kind.drives) continue;
    if (!last.empty()) words += (words.empty() ? "" : ", ") + last;
    last = kind.noun;
  }
  return words + " or " + last;
}

// The words of real kinds of buses.
std::string what_has_an_imu() {
  std::string words;
  for (const BusFacts& kind : kBusFacts)
    if (kind.real && kind.has_imu) words += (words.empty() ? "" : " or ") + std::string(kind.word);
  return words;
}

}  // namespace

void check_bus(Reader& in, const RobotConfig& robot) {
  const BusConfig& bus = robot.buses.back();
  const std::string place = hardware_of(bus);
  for (std::size_t i = 0; i + 1 < robot.buses.size(); ++i) {
    const BusConfig& other = robot.buses[i];
    if (place.empty() || hardware_of(other) != place ||
        (other.kind != bus.kind && !(is_serial(other) && is_serial(bus)))) {
      continue;
    }
    in.complain(kPlaceKeys[static_cast<std::size_t>(facts(bus.kind).place)],
                fmt::format("this is \"{}\" already: both would command the same drives; name another one, or put all "
                            "devices on one bus",
                            other.name));
  }
  if (is_real(bus) && bus.reply_wait_s * robot.rate_hz > robot.spine.late_ticks_to_stop) {
    in.complain("reply_wait_s", fmt::format("{} s are more than the {} late ticks after which the robot stops; give at "
                                            "most {:g}",
                                            bus.reply_wait_s, robot.spine.late_ticks_to_stop,
                                            robot.spine.late_ticks_to_stop / robot.rate_hz));
  }
}

void check_neighbours(Reader& in, const RobotConfig& robot, bool has_id) {
  const DeviceConfig& device = robot.devices.back();
  for (std::size_t i = 0; i + 1 < robot.devices.size(); ++i) {
    const DeviceConfig& other = robot.devices[i];
    if (other.bus != device.bus) continue;
    if (has_id && other.id == device.id)
      in.complain("id", fmt::format("{} is already taken on this bus by \"{}\"", device.id, other.name));
    if (!go_together(other.kind, device.kind)) {
      in.complain("bus", fmt::format("\"{}\" on it is a {}, this is a {}: their frames carry the same ids; give them "
                                     "a bus each",
                                     other.name, word(other.kind), word(device.kind)));
      return;
    }
    const bool together = facts(device.kind).is_synced && facts(other.kind).is_synced;
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
  const DeviceFacts& kind = facts(device.kind);
  const bool asked = kind.asked;
  const double slow_s = device.rate_divider * std::max(1.0 / robot.rate_hz, longest_wait_s(robot));
  if (asked && device.watchdog_s * asked_hz >= 4.0 && device.watchdog_s < 2.0 * slow_s) {
    in.complain("watchdog_s",
                fmt::format("{} s are less than two commands when another drive's answers are waited for, "
                            "up to {:g} s each time; give at least {:g}, or a shorter reply_wait_s",
                            device.watchdog_s, longest_wait_s(robot), 2.0 * slow_s));
  }
  if (asked && device.watchdog_s * asked_hz < 4.0) {
    in.complain("watchdog_s", fmt::format("{} s is less than 4 {} at {} Hz, the device would stop by itself; "
                                          "give at least {}",
                                          device.watchdog_s, device.rate_divider == 1 ? "ticks" : "commands", asked_hz,
                                          4.0 / asked_hz));
  }
  if (device.bus >= robot.buses.size()) return;
  const BusConfig& bus = robot.buses[device.bus];
  if (kind.needs_fd && !is_fd(bus)) {
    in.complain("bus", fmt::format("\"{}\" carries classic CAN only, {} speaks CAN FD; give the bus a "
                                   "data_bitrate, if its adapter can, or use another bus",
                                   bus.name, kind.noun));
  }
  if (kind.needs_classic && !carries_classic(bus))
    in.complain("bus", fmt::format("\"{}\" {}", bus.name, facts(bus.kind).no_classic));
  if (!kind.on_bus && !facts(bus.kind).has_imu) {
    in.complain("bus",
                fmt::format("\"{}\" is of a kind that has no imu; name a bus of the {}", bus.name, what_has_an_imu()));
  }
}

void check_joint(Reader& in, const RobotConfig& robot, const JointConfig& joint, const DeviceConfig& device) {
  const DeviceFacts& kind = facts(device.kind);
  if (kind.drives && !kind.tells_home && joint.must_be_homed) {
    in.complain("must_be_homed", fmt::format("\"{}\" is {}, which does not tell whether it is homed: say "
                                             "false, and home the drive before the robot is armed",
                                             device.name, kind.noun));
  }
  if (kind.check_joint == nullptr) return;
  const double rev_per_rad = joint.ratio / (2.0 * std::numbers::pi);
  const double farthest_rad =
      std::max(std::abs(joint.position_min_rad - joint.zero_rad), std::abs(joint.position_max_rad - joint.zero_rad));
  kind.check_joint(in, device.keys,
                   {.device = device.name,
                    .farthest_rev = farthest_rad * rev_per_rad,
                    .fault_rev = (farthest_rad + robot.guard.position_overrun_rad) * rev_per_rad,
                    .fault_rev_s = joint.velocity_max_rad_s * robot.guard.velocity_overrun * rev_per_rad,
                    .torque_nm = joint.torque_max_nm / joint.ratio,
                    .power_limited = joint.power_max_w > 0});
}

void check_sensor(Reader& in, const RobotConfig& robot) {
  const SensorConfig& sensor = robot.sensors.back();
  if (sensor.device >= robot.devices.size()) return;
  const DeviceConfig& device = robot.devices[sensor.device];
  const DeviceFacts& kind = facts(device.kind);
  const std::size_t channels = inputs_of(device, sensor.kind);
  if (kind.drives) {
    in.complain("device", fmt::format("\"{}\" is a {}; sensors hang on {}", device.name, kind.word, what_measures()));
  } else if (kind.inputs[static_cast<std::size_t>(sensor.kind)] == 0) {
    in.complain("kind", std::string(kind.other_inputs));
  } else if (channels == 0) {
    in.complain("kind", fmt::format("\"{}\" has no inputs of this kind by its own table", device.name));
  } else if (sensor.channel >= channels) {
    in.complain("channel", fmt::format("{} is more than {} has: 0 to {}", sensor.channel,
                                       sensor.kind == SensorKind::imu ? "an IMU" : kind.noun, channels - 1));
  }
  for (std::size_t i = 0; i + 1 < robot.sensors.size(); ++i) {
    const SensorConfig& other = robot.sensors[i];
    if (other.device == sensor.device && other.kind == sensor.kind && other.channel == sensor.channel)
      in.complain("channel", fmt::format("{} is \"{}\" already", sensor.channel, other.name));
  }
}

}  // namespace lithe::robot
