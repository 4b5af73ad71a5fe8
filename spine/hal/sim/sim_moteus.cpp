// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/sim/sim_moteus.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "spine/core/time.hpp"

namespace lithe::hal {
namespace {

using namespace moteus;

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr double kStepS = static_cast<double>(Plant::kStepNs) / static_cast<double>(kNsPerS);
constexpr std::int64_t kMostCatchUpNs = 200 * kNsPerMs;
constexpr std::uint32_t kUnknownRegister = 1, kNotWritable = 2;
constexpr std::uint8_t kStartOutsideLimit = 39;
constexpr std::uint8_t kTorqueLimitCode = 102;
// The velocity estimate is a tracking loop, as in the firmware: critically damped, this fast.
constexpr double kTrackerRadS = 1000.0;

}  // namespace

SimMoteus::Fields SimMoteus::defaults() LITHE_RT {
  return {0.0, 0.0, 0.0, 1.0, 1.0, kNaN, kNaN, 0.0, kNaN, kNaN};
}

SimMoteus::SimMoteus(const MoteusSettings& settings, const robot::PlantConfig& plant, const SimServo& servo)
    : settings_(settings), servo_(servo), plant_(plant), counts_per_rev_(plant.encoder_counts) {
  tracked_rev_ = settings_.map.motor_rev(plant_.position_rad());
  sense();
}

void SimMoteus::inject_fault(std::uint8_t code) LITHE_RT {
  mode_ = kFaulted;
  fault_ = code;
}

bool SimMoteus::serve(const Frame& frame, Frame& reply, std::int64_t now_ns) LITHE_RT {
  const std::uint32_t destination = frame.id & 0x7fU;
  if (destination != settings_.id && destination != 0x7fU) return false;
  if (frame.id >> 16 != 0 || frame.size > frame.data.size()) return false;
  advance(now_ns);
  Writer writer(reply.data);
  Reader reader({frame.data.data(), frame.size});
  Subframe subframe;
  bool wrote_mode = false;
  while (reader.next(subframe)) {
    if (subframe.type == Subframe::Type::write) {
      for (std::uint32_t i = 0; i < subframe.count; ++i) {
        write_register(subframe.start + i, subframe.values[i], wrote_mode, writer);
      }
    } else if (subframe.type == Subframe::Type::read) {
      const std::size_t before = writer.size();
      answer_read(subframe, writer);
      if (writer.size() > before && reply.data[before] == 0x31) break;  // a read error ends the frame
    } else {
      break;
    }
  }
  if (wrote_mode) apply_command();
  if ((frame.id & 0x8000U) == 0) return false;
  reply.size = static_cast<std::uint8_t>(writer.finish());
  reply.id = static_cast<std::uint32_t>(settings_.id) << 8 | ((frame.id >> 8) & 0x7fU);
  reply.extended = reply.id > 0x7ffU;  // ids 1 to 7 fit an 11-bit frame
  reply.fd = frame.fd || reply.size > 8;
  reply.bit_rate_switch = frame.bit_rate_switch;
  return true;
}

void SimMoteus::write_register(std::uint32_t address, double value, bool& wrote_mode, Writer& writer) LITHE_RT {
  if (address == kMode) {
    if (!(value >= 0 && value < 16)) return writer.error(true, address, kUnknownRegister);
    written_ = defaults();
    written_mode_ = static_cast<std::uint8_t>(value);
    wrote_mode = true;
    return;
  }
  double* const fields[] = {&written_.position,   &written_.velocity, &written_.torque,    &written_.kp_scale,
                            &written_.kd_scale,   &written_.max_torque, &written_.stop,    &written_.timeout_s,
                            &written_.velocity_limit, &written_.accel_limit};
  if (address >= kCommandPosition && address <= kAccelLimit) {
    *fields[address - kCommandPosition] = value;
  } else if (address != kIlimitScale) {  // accepted and without effect: this servo has no integrator
    double present = 0;
    writer.error(true, address, read_register(address, present) ? kNotWritable : kUnknownRegister);
  }
}

bool SimMoteus::read_register(std::uint32_t address, double& value) const LITHE_RT {
  switch (address) {
    case kMode: value = mode_; return true;
    case kPosition: value = position_rev_; return true;
    case kVelocity: value = velocity_rev_s_; return true;
    case kTorque: value = settings_.map.motor_nm(plant_.torque_nm()); return true;
    case kQCurrent: case kDCurrent: case kPower: case kTrajectoryComplete: value = 0; return true;
    case kAbsPosition: value = position_rev_; return true;
    case kHomeState: value = 2; return true;
    case kMotorTemperature: case kTemperature: value = 25; return true;
    case kVoltage: value = servo_.supply_v; return true;
    case kFault: value = fault_; return true;
    case kFirmware: value = 0x010000; return true;
    case kRegisterMap: value = 5; return true;
    case kModel: value = 0; return true;
    default: return false;
  }
}

void SimMoteus::answer_read(const Subframe& subframe, Writer& writer) LITHE_RT {
  std::array<double, 32> values{};
  for (std::uint32_t i = 0; i < subframe.count; ++i) {
    if (!read_register(subframe.start + i, values[i])) {
      return writer.error(false, subframe.start + i, kUnknownRegister);
    }
  }
  writer.reply(subframe.start, subframe.resolution, {values.data(), subframe.count});
}

void SimMoteus::apply_command() LITHE_RT {
  const std::uint8_t mode = written_mode_;
  if (mode >= 1 && mode <= 4) return;  // the drive passes through these by itself
  if (mode == kStopped) {
    mode_ = wanted_mode_ = kStopped;
    fault_ = 0;
    return;
  }
  if (mode_ == kFaulted || mode_ == kTimeout) return;  // latched: only mode 0 leads out
  active_ = written_;
  const double timeout_s = active_.timeout_s == 0.0 ? servo_.default_timeout_s : active_.timeout_s;
  watchdog_left_s_ = timeout_s;  // NaN: never runs out
  wanted_mode_ = mode;
  if (mode_ == kStopped) {
    mode_ = kEnabling;
    enabling_left_s_ = servo_.enable_s;
  } else if (mode_ > kCalibrationComplete && mode_ != mode) {
    mode_ = mode;
    if (mode == kPositionMode) start_position_mode();
  } else if (mode_ == kPositionMode && std::isnan(active_.position) && active_.kp_scale != 0.0 &&
             std::isnan(control_position_rev_)) {
    control_position_rev_ = position_rev_;
  }
}

void SimMoteus::start_position_mode() LITHE_RT {
  if (position_rev_ < servo_.position_min_rev || position_rev_ > servo_.position_max_rev) {
    inject_fault(kStartOutsideLimit);
    return;
  }
  control_position_rev_ = position_rev_;
  control_velocity_rev_s_ = velocity_rev_s_;
}

void SimMoteus::advance(std::int64_t now_ns) LITHE_RT {
  if (lived_until_ns_ == 0 || now_ns - lived_until_ns_ > kMostCatchUpNs) {
    const std::int64_t from_ns = now_ns - kMostCatchUpNs;
    lived_until_ns_ = lived_until_ns_ == 0 ? now_ns : from_ns;
  }
  while (lived_until_ns_ + Plant::kStepNs <= now_ns) {
    step();
    lived_until_ns_ += Plant::kStepNs;
  }
}

void SimMoteus::step() LITHE_RT {
  if (mode_ >= kEnabling && mode_ <= kCalibrationComplete) {
    enabling_left_s_ -= kStepS;
    if (enabling_left_s_ <= 0) {
      mode_ = wanted_mode_;
      if (mode_ == kPositionMode) start_position_mode();
    } else {
      mode_ = enabling_left_s_ > servo_.enable_s / 2 ? kEnabling : kCalibrating;
    }
  }
  if (mode_ == kPositionMode || mode_ == kStayWithin) {
    watchdog_left_s_ -= kStepS;
    if (watchdog_left_s_ <= 0) mode_ = kTimeout;
  }
  const double asked_nm = motor_torque_nm();
  plant_.step(settings_.map.torque_nm(std::clamp(asked_nm, -servo_.max_torque_nm, servo_.max_torque_nm)));
  sense();
}

double SimMoteus::motor_torque_nm() LITHE_RT {
  if (mode_ == kTimeout || mode_ == kZeroVelocity) {
    const double most = mode_ == kTimeout ? servo_.timeout_max_torque_nm : servo_.max_torque_nm;
    return std::clamp(-servo_.kd_nm_s_rev * velocity_rev_s_, -most, most);
  }
  if (mode_ == kBrakeMode) return -4.0 * servo_.kd_nm_s_rev * velocity_rev_s_;  // shorted phases: stronger damping
  if (mode_ != kPositionMode) return 0.0;
  follow_target();
  const double most = std::isnan(active_.max_torque) ? servo_.max_torque_nm : std::abs(active_.max_torque);
  const double wanted = servo_.kp_nm_rev * active_.kp_scale * (control_position_rev_ - position_rev_) +
                        servo_.kd_nm_s_rev * active_.kd_scale * (control_velocity_rev_s_ - velocity_rev_s_) +
                        active_.torque;
  fault_ = std::abs(wanted) > most ? kTorqueLimitCode : 0;
  return std::clamp(wanted, -most, most);
}

// The servo's own target: jumps to the commanded one without limits, else moves there along a trapezoid.
void SimMoteus::follow_target() LITHE_RT {
  const double velocity = std::isnan(active_.velocity) ? 0.0 : active_.velocity;
  const double accel = std::isnan(active_.accel_limit) ? servo_.default_accel_limit_rev_s2 : active_.accel_limit;
  const bool plans = accel >= 0.0 && active_.kp_scale != 0.0;
  if (!plans) {
    control_velocity_rev_s_ = velocity;
    // The target moves on with its velocity between two commands; a new command sets it anew.
    control_position_rev_ = std::isnan(active_.position) ? control_position_rev_ + velocity * kStepS : active_.position;
    if (!std::isnan(active_.position)) active_.position += velocity * kStepS;
    return;
  }
  const double goal = std::isnan(active_.position) ? control_position_rev_ : active_.position;
  const double left = goal - control_position_rev_;
  const double most = active_.velocity_limit >= 0.0 ? active_.velocity_limit : std::numeric_limits<double>::infinity();
  const double braking = std::copysign(std::sqrt(2.0 * accel * std::abs(left)), left) + velocity;
  const double wanted = std::clamp(braking, -most, most);
  control_velocity_rev_s_ += std::clamp(wanted - control_velocity_rev_s_, -accel * kStepS, accel * kStepS);
  const double move = control_velocity_rev_s_ * kStepS;
  control_position_rev_ = std::abs(left) <= std::abs(move) ? goal : control_position_rev_ + move;
}

void SimMoteus::sense() LITHE_RT {
  const double true_rev = settings_.map.motor_rev(plant_.position_rad());
  position_rev_ = std::floor(true_rev * counts_per_rev_ + 0.5) / counts_per_rev_;
  const double error = position_rev_ - tracked_rev_;
  velocity_rev_s_ += kTrackerRadS * kTrackerRadS * error * kStepS;
  tracked_rev_ += (velocity_rev_s_ + 2.0 * kTrackerRadS * error) * kStepS;
}

}  // namespace lithe::hal
