// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/device/moteus.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>

#include "spine/wire/wire.hpp"

namespace lithe::hal {
namespace {

using moteus::Resolution;

constexpr double kTwoPi = 2.0 * std::numbers::pi;
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
// A reply beyond these is noise or a lie, whatever the motor: the int32 scaling itself ends at 21474 rev.
constexpr double kMostRev = 20000, kMostRevPerS = 20000, kMostNm = 1000;

moteus::Mode mode_for(DriveAction action) LITHE_RT {
  switch (action) {
    case DriveAction::torque:
      return moteus::kPositionMode;
    case DriveAction::damp:
      return moteus::kZeroVelocity;
    case DriveAction::brake:
      return moteus::kBrakeMode;
    case DriveAction::off:
      break;
  }
  return moteus::kStopped;
}

bool within(double value, double most) LITHE_RT { return std::abs(value) <= most; }  // false for NaN

}  // namespace

double JointMap::motor_rev(double position) const LITHE_RT { return sign * (position - zero_rad) * ratio / kTwoPi; }
double JointMap::motor_rev_s(double velocity) const LITHE_RT { return sign * velocity * ratio / kTwoPi; }
double JointMap::position_rad(double rev) const LITHE_RT { return sign * rev * kTwoPi / ratio + zero_rad; }
double JointMap::velocity_rad_s(double rev_s) const LITHE_RT { return sign * rev_s * kTwoPi / ratio; }

void MoteusDriver::encode(const JointCommand& command, Frame& frame) const LITHE_RT {
  moteus::Writer writer(frame.data);
  const std::array<double, 1> mode{static_cast<double>(mode_for(command.action))};
  writer.write(moteus::kMode, Resolution::int8, mode);
  if (command.action == DriveAction::torque) encode_torque(command, writer);
  writer.read(moteus::kMode, Resolution::int8, 1);
  writer.read(moteus::kPosition, Resolution::f32, 3);
  writer.read(moteus::kVoltage, Resolution::int8, 3);
  frame.size = static_cast<std::uint8_t>(writer.finish());
  frame.id = moteus::arbitration_id(0, settings_.id, true);
  frame.extended = true;  // the reply bit does not fit an 11-bit id
  frame.fd = true;
  frame.bit_rate_switch = true;
}

void MoteusDriver::encode_torque(const JointCommand& command, moteus::Writer& writer) const LITHE_RT {
  const JointMap& map = settings_.map;
  const bool has_position = !std::isnan(command.position_rad);
  // Joint gains seen from the motor: both angle and torque shrink by the ratio.
  const double to_rev = kTwoPi / (map.ratio * map.ratio);
  const double kp_scale = has_position ? command.kp_nm_rad * to_rev / settings_.servo_kp_nm_rev : 0.0;
  const double kd_scale = command.kd_nm_s_rad * to_rev / settings_.servo_kd_nm_s_rev;
  const std::array<double, 6> target{has_position ? map.motor_rev(command.position_rad) : kNaN,
                                     map.motor_rev_s(command.velocity_rad_s),
                                     map.motor_nm(command.torque_nm),
                                     kp_scale,
                                     kd_scale,
                                     command.max_torque_nm / map.ratio};
  writer.write(moteus::kCommandPosition, Resolution::f32, target);
  // -1: no planner inside the drive, the Spine streams its setpoints; without it the drive re-plans every command.
  const std::array<double, 3> watchdog_and_limits{settings_.watchdog_s, -1.0, -1.0};
  writer.write(moteus::kWatchdogTimeout, Resolution::f32, watchdog_and_limits);
  const std::array<double, 1> no_integrator{0.0};
  writer.write(moteus::kIlimitScale, Resolution::int8, no_integrator);
}

bool MoteusDriver::decode(const Frame& frame, JointReading& reading) const LITHE_RT {
  if ((frame.id & 0x7f00U) >> 8 != settings_.id || (frame.id & 0x807fU) != 0 || frame.size > frame.data.size()) {
    return false;
  }
  double mode = kNaN, position = kNaN, velocity = kNaN, torque = kNaN, fault = kNaN;
  moteus::Reader reader({frame.data.data(), frame.size});
  moteus::Subframe subframe;
  // A reply of ours has three subframes; the bound holds whatever arrives.
  for (int i = 0; i < 16 && reader.next(subframe); ++i) {
    if (subframe.type != moteus::Subframe::Type::reply) continue;
    for (std::uint32_t k = 0; k < subframe.count; ++k) {
      const double value = subframe.values[k];
      switch (subframe.start + k) {
        case moteus::kMode:
          mode = value;
          break;
        case moteus::kPosition:
          position = value;
          break;
        case moteus::kVelocity:
          velocity = value;
          break;
        case moteus::kTorque:
          torque = value;
          break;
        case moteus::kFault:
          fault = value;
          break;
        default:
          break;
      }
    }
  }
  if (reader.malformed() || !within(position, kMostRev) || !within(velocity, kMostRevPerS) ||
      !within(torque, kMostNm) || !(mode >= 0 && mode <= 255) || !(fault >= 0 && fault <= 255)) {
    return false;
  }
  const auto mode_code = static_cast<std::uint32_t>(mode);
  const auto fault_code = static_cast<std::uint32_t>(fault);
  reading.position_rad = settings_.map.position_rad(position);
  reading.velocity_rad_s = settings_.map.velocity_rad_s(velocity);
  reading.torque_nm = settings_.map.torque_nm(torque);
  reading.status = wire::joint_status::kFresh | fault_code << 8 | mode_code << 16;
  if (mode_code == moteus::kFaulted) reading.status |= wire::joint_status::kFault;
  if (mode_code == moteus::kTimeout) reading.status |= wire::joint_status::kWatchdog;
  return true;
}

}  // namespace lithe::hal
