// SPDX-License-Identifier: Apache-2.0
#include "spine/robot/hardware.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <numbers>

namespace lithe::robot {
namespace {

// Identity of the hardware: buses with the same name share it. Empty = not shared.
std::string hardware_of(const BusConfig& bus) {
  if (bus.kind == BusKind::socketcan) return bus.interface;
  if (bus.kind == BusKind::loop) return "";
  if (bus.kind == BusKind::pi3hat) return fmt::format("JC{}", bus.connector);
  std::error_code wrong;
  const std::filesystem::path real = std::filesystem::weakly_canonical(bus.path, wrong);
  return wrong ? bus.path : real.string();
}

// The longest exchange: all buses wait until the last answer has come.
double longest_wait_s(const RobotConfig& robot) {
  double longest_s = 0;
  for (const BusConfig& bus : robot.buses) {
    if (bus.kind != BusKind::loop) longest_s = std::max(longest_s, bus.reply_wait_s);
  }
  return longest_s;
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
    in.complain(bus.kind == BusKind::socketcan ? "interface" : (is_serial(bus) ? "path" : "connector"),
                fmt::format("this is \"{}\" already: both would command the same drives; name another one, or put all "
                            "devices on one bus",
                            other.name));
  }
  if (bus.kind != BusKind::loop && bus.reply_wait_s * robot.rate_hz > robot.spine.late_ticks_to_stop) {
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
    if (has_id && other.id == device.id) {
      in.complain("id", fmt::format("{} is already taken on this bus by \"{}\"", device.id, other.name));
    }
    if (other.kind != device.kind && is_drive(other.kind) && is_drive(device.kind)) {
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
  const bool asked = device.kind != DeviceKind::gateway;
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
  if (device.kind == DeviceKind::cia402 && bus.kind == BusKind::pi3hat && is_fd(bus)) {
    in.complain("bus", fmt::format("\"{}\" is a connector with CAN FD, which sends nothing else; CANopen drives speak "
                                   "classic CAN: say data_bitrate = 0 there",
                                   bus.name));
  }
  if (device.kind == DeviceKind::imu && bus.kind != BusKind::pi3hat && bus.kind != BusKind::loop) {
    in.complain("bus", fmt::format("\"{}\" is of a kind that has no imu; name a bus of the pi3hat", bus.name));
  }
}

namespace {

struct LargestNumbers {
  double position_rev, velocity_rev_s, torque_nm;
};
// Range of an integer format in a moteus frame: largest count times the unit of one count.
constexpr LargestNumbers kInInt8{127 * 0.01, 127 * 0.1, 127 * 0.5};
constexpr LargestNumbers kInInt16{32767 * 0.0001, 32767 * 0.00025, 32767 * 0.01};

// A value beyond its format would be clipped.
void check_frames(Reader& in, const RobotConfig& robot, const JointConfig& joint, const DeviceConfig& device) {
  const auto narrower = std::min(device.frames.command, device.frames.answer);
  if (narrower != NumberFormat::int8 && narrower != NumberFormat::int16) return;
  const LargestNumbers& most = narrower == NumberFormat::int8 ? kInInt8 : kInInt16;
  const std::string_view name = narrower == NumberFormat::int8 ? "int8" : "int16";
  const double turns = joint.ratio / (2.0 * std::numbers::pi);
  const double farthest_rad =
      std::max(std::abs(joint.position_min_rad - joint.zero_rad), std::abs(joint.position_max_rad - joint.zero_rad)) +
      robot.guard.position_overrun_rad;
  const auto complain = [&](std::string_view key, double needed, double largest, std::string_view unit) {
    in.complain(key, fmt::format("needs {:.3g} {} of the motor, and {} of \"{}\" ends at {:.4g}: say \"float\" in "
                                 "[device.frames]",
                                 needed, unit, name, device.name, largest));
  };
  if (const double rev = farthest_rad * turns; rev >= most.position_rev) {
    complain("position_max_rad", rev, most.position_rev, "turns");
  }
  const double rev_s = joint.velocity_max_rad_s * robot.guard.velocity_overrun * turns;
  if (rev_s >= most.velocity_rev_s) complain("velocity_max_rad_s", rev_s, most.velocity_rev_s, "turns/s");
  if (const double nm = joint.torque_max_nm / joint.ratio; nm >= most.torque_nm) {
    complain("torque_max_nm", nm, most.torque_nm, "Nm");
  }
}

}  // namespace

void check_joint(Reader& in, const RobotConfig& robot, const JointConfig& joint, const DeviceConfig& device) {
  if (device.kind == DeviceKind::moteus) check_frames(in, robot, joint, device);
  if (device.kind != DeviceKind::cia402) return;
  if (joint.must_be_homed) {
    in.complain("must_be_homed", fmt::format("\"{}\" is a cia402 drive, which does not tell whether it is homed: say "
                                             "false, and home the drive before the robot is armed",
                                             device.name));
  }
  if (joint.power_max_w > 0 && device.mode != DriveMode::torque) {
    in.complain("power_max_w",
                fmt::format("\"{}\" closes its own loop (mode), so its power cannot be limited here: set 0, "
                            "or use mode = \"torque\"",
                            device.name));
  }
  const double farthest_rad =
      std::max(std::abs(joint.position_min_rad - joint.zero_rad), std::abs(joint.position_max_rad - joint.zero_rad));
  const double counts = farthest_rad * joint.ratio / (2.0 * std::numbers::pi) * device.counts_per_rev;
  constexpr double kMostCounts = 2147483647.0;  // object 6064h has 32 bits
  if (counts <= kMostCounts) return;
  in.complain("ratio",
              fmt::format("the joint's range is {:.3g} counts of \"{}\", which counts to {:.3g}; set a coarser "
                          "unit in the drive (608Fh), and counts_per_rev to it",
                          counts, device.name, kMostCounts));
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
  if (device.kind == DeviceKind::imu && sensor.kind != SensorKind::imu) {
    in.complain("kind", "what hangs on an imu has kind = \"imu\": attitude w x y z, angular rate, acceleration");
  }
  if (sensor.kind == SensorKind::imu && sensor.channel >= kImuChannels) {
    in.complain("channel", fmt::format("{} is more than an IMU has: 0 to 9", sensor.channel));
  }
  for (std::size_t i = 0; i + 1 < robot.sensors.size(); ++i) {
    const SensorConfig& other = robot.sensors[i];
    if (other.device == sensor.device && other.kind == sensor.kind && other.channel == sensor.channel) {
      in.complain("channel", fmt::format("{} is \"{}\" already", sensor.channel, other.name));
    }
  }
}

}  // namespace lithe::robot
