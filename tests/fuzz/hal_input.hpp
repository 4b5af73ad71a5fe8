// SPDX-License-Identifier: Apache-2.0
// Commands and joints out of bytes, and a bus that keeps what a driver sends.
#pragma once

#include <cmath>

#include "spine/hal/core/bus.hpp"
#include "spine/hal/core/drive.hpp"
#include "tests/fuzz/fuzz.hpp"

namespace lithe::fuzz {

// What no motor does, and no answer may say: beyond it a number is noise.
inline constexpr double kMotorRev = 32768;
inline constexpr double kMotorRevPerS = 3000;

// Within what robot.toml allows.
inline hal::JointTransform joint_of(Input& input) {
  constexpr std::array<double, 4> kRatios{1.0, 20.0, 1e-3, 1e4};
  constexpr std::array<double, 3> kZeros{0.0, -1e4, 0.25};
  const std::uint8_t choice = input.byte();
  return {(choice & 1) != 0 ? -1.0 : 1.0, kZeros[choice / 16 % 3], kRatios[choice / 2 % 4]};
}

inline constexpr std::array<double hal::JointCommand::*, 6> kFields{
    &hal::JointCommand::torque_nm, &hal::JointCommand::target_rad,  &hal::JointCommand::target_rad_s,
    &hal::JointCommand::kp_nm_rad, &hal::JointCommand::kd_nm_s_rad, &hal::JointCommand::max_torque_nm};

inline hal::JointCommand command_of(Input& input) {
  hal::JointCommand command;
  command.action = static_cast<hal::DriveAction>(input.byte() % 4);
  for (double hal::JointCommand::* field : kFields) command.*field = input.real();
  return command;
}

inline void write(Script& script, const hal::JointCommand& command) {
  script.byte(static_cast<unsigned>(command.action));
  for (double hal::JointCommand::* field : kFields) script.real(command.*field);
}

inline bool is_sound(const hal::JointCommand& command) {
  if (command.action != hal::DriveAction::torque) return true;
  for (double hal::JointCommand::* field : kFields) {
    const bool none = field == &hal::JointCommand::target_rad && std::isnan(command.*field);
    if (!std::isfinite(command.*field) && !none) return false;
  }
  return true;
}

// Holds what was sent until it is cleared. It always has room: what a driver sends is bounded, or that is found.
class Outbox final : public hal::Bus {
 public:
  static constexpr std::size_t kMost = 32;

  void begin(std::int64_t /*now_ns*/) LITHE_RT override { size_ = 0; }
  bool send(const hal::Frame& frame) LITHE_RT override {
    if (size_ < kMost) frames_[size_] = frame;
    ++size_;
    return true;
  }
  bool receive(hal::Frame& /*frame*/) LITHE_RT override { return false; }
  std::span<const hal::Frame> sent() const {
    require(size_ <= kMost, "a driver sends few frames at a time");
    return {frames_.data(), size_};
  }

 private:
  std::array<hal::Frame, kMost> frames_{};
  std::size_t size_ = 0;
};

// What reaches the map is a number, and one that a motor can have.
inline void check_measured(const hal::JointSample& sample, const hal::JointTransform& joint, double most_rev,
                           double most_motor_nm) {
  constexpr double kRounding = 1 + 1e-9;
  const double rad_per_rev = 1 / std::abs(joint.rev_per_rad());
  require(std::isfinite(sample.position_rad) && std::isfinite(sample.velocity_rad_s) && std::isfinite(sample.torque_nm),
          "what is measured is finite");
  require(std::abs(sample.position_rad) <= (most_rev * rad_per_rev + std::abs(joint.zero_rad)) * kRounding,
          "no position beyond what a drive counts");
  require(std::abs(sample.velocity_rad_s) <= kMotorRevPerS * rad_per_rev * kRounding, "no speed beyond any motor's");
  require(std::abs(sample.torque_nm) <= most_motor_nm * joint.ratio * kRounding, "no torque beyond any motor's");
}

}  // namespace lithe::fuzz
