// SPDX-License-Identifier: Apache-2.0
#include "spine/robot/keys/device_keys.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <numbers>
#include <string_view>

namespace lithe::robot {
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

void read_moteus(Reader& in, DeviceConfig& device, Need /*need*/) {
  in.boolean("may_hold_alone", device.may_hold_alone);
}

void read_cia402(Reader& in, DeviceConfig& device, Need need) {
  in.choice<DriveMode>(
      "mode", device.mode,
      {{"torque", DriveMode::torque}, {"position", DriveMode::position}, {"velocity", DriveMode::velocity}});
  in.number("counts_per_rev", device.counts_per_rev, {1.0, 1.0e9});
  in.number("rated_torque_nm", device.rated_torque_nm, {1.0e-9, 1.0e6}, need);
}

void check_cia402(Reader& in, const RobotConfig& /*robot*/, const JointConfig& joint, const DeviceConfig& device) {
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

void read_cia401(Reader& in, DeviceConfig& device, Need /*need*/) {
  const auto& most = facts(device.kind).inputs;
  in.integer("digital_inputs", device.digital_inputs, {0, static_cast<double>(most[1])});
  in.integer("analog_inputs", device.analog_inputs, {0, static_cast<double>(most[0])});
  in.number("send_every_s", device.send_every_s, {0.001, 10.0});
  if (device.digital_inputs + device.analog_inputs == 0) {
    in.complain("digital_inputs", "the device has no inputs; give digital_inputs or analog_inputs");
  }
  if (2 * device.send_every_s > device.watchdog_s) {
    in.complain("send_every_s", fmt::format("{:g} s are more than half of watchdog_s: one lost frame would make its "
                                            "values invalid; give at most {:g}",
                                            device.send_every_s, device.watchdog_s / 2));
  }
}

std::size_t cia401_inputs(const DeviceConfig& device, SensorKind kind) {
  if (kind == SensorKind::imu) return 0;
  return kind == SensorKind::analog ? device.analog_inputs : device.digital_inputs;
}

struct KeysOf {
  DeviceKind kind;
  void (*read)(Reader&, DeviceConfig&, Need) = nullptr;
  void (*check_joint)(Reader&, const RobotConfig&, const JointConfig&, const DeviceConfig&) = nullptr;
  std::size_t (*inputs)(const DeviceConfig&, SensorKind) = nullptr;  // null: as many as its kind
};

constexpr std::array<KeysOf, kDeviceFacts.size()> kKeys{{
    {.kind = DeviceKind::moteus, .read = read_moteus, .check_joint = check_frames},
    {.kind = DeviceKind::cia402, .read = read_cia402, .check_joint = check_cia402},
    {.kind = DeviceKind::gateway},
    {.kind = DeviceKind::imu},
    {.kind = DeviceKind::cia401, .read = read_cia401, .inputs = cia401_inputs},
}};
static_assert(in_order(kKeys));

const KeysOf& keys_of(DeviceKind kind) { return kKeys[static_cast<std::size_t>(kind)]; }

}  // namespace

std::size_t inputs_of(const DeviceConfig& device, SensorKind kind) {
  const KeysOf& keys = keys_of(device.kind);
  return keys.inputs != nullptr ? keys.inputs(device, kind) : facts(device.kind).inputs[static_cast<std::size_t>(kind)];
}

void read_keys(Reader& in, DeviceConfig& device, Need need) {
  const KeysOf& keys = keys_of(device.kind);
  if (keys.read != nullptr) keys.read(in, device, need);
}

void check_joint(Reader& in, const RobotConfig& robot, const JointConfig& joint, const DeviceConfig& device) {
  const DeviceFacts& kind = facts(device.kind);
  if (kind.drives && !kind.tells_home && joint.must_be_homed) {
    in.complain("must_be_homed", fmt::format("\"{}\" is {}, which does not tell whether it is homed: say "
                                             "false, and home the drive before the robot is armed",
                                             device.name, kind.noun));
  }
  const KeysOf& keys = keys_of(device.kind);
  if (keys.check_joint != nullptr) keys.check_joint(in, robot, joint, device);
}

}  // namespace lithe::robot
