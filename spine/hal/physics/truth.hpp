// SPDX-License-Identifier: Apache-2.0
// The true parameters of a simulated joint: the robot file's values, plus random values within the file's bounds.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>

#include "spine/core/rt.hpp"
#include "spine/hal/bus/loop/draws.hpp"
#include "spine/robot/config.hpp"

namespace lithe::hal::sim {

// Errors of a simulated drive, in joint coordinates. All zero: an ideal drive.
struct DriveErrors {
  double torque_gain = 0;         // the joint gets (1 + this) times the commanded and reported torque
  double torque_noise_nm = 0;     // standard deviation of the reported torque
  double encoder_noise_rad = 0;   // standard deviation of each of its readings
  double encoder_offset_rad = 0;  // reported angle minus the joint's angle
  std::int64_t delay_ns = 0;      // from a command's frame to its effect in the mode that runs; whole steps
  std::uint64_t seed = 1;         // of the noise
};

// The two errors that change with time.
// Contract: RT · one thread · same seed, same numbers
class ErrorSource {
 public:
  explicit ErrorSource(const DriveErrors& errors) : errors_(errors), draws_(errors.seed) {}

  // Error of the next encoder reading [rad].
  double encoder_error_rad() LITHE_RT {
    const double noise = errors_.encoder_noise_rad > 0 ? errors_.encoder_noise_rad * draws_.normal() : 0;
    return errors_.encoder_offset_rad + noise;
  }
  // The joint's torque when the drive commands `meant_nm`; the reported torque when the joint gets `given_nm`.
  double given_nm(double meant_nm) const LITHE_RT { return meant_nm * (1 + errors_.torque_gain); }
  double told_nm(double given_nm) const LITHE_RT { return given_nm / (1 + errors_.torque_gain) + torque_error_nm_; }
  // Call once per step of the plant.
  void step() LITHE_RT {
    if (errors_.torque_noise_nm > 0) torque_error_nm_ = errors_.torque_noise_nm * draws_.normal();
  }
  std::int64_t delay_ns() const LITHE_RT { return errors_.delay_ns; }

 private:
  DriveErrors errors_;
  Draws draws_;
  double torque_error_nm_ = 0;
};

// Delays a number by a number of plant steps; 0 before.
// Contract: RT · one thread
class StepDelay {
 public:
  static constexpr std::size_t kMost = 20;  // 1 ms
  explicit StepDelay(std::size_t steps) : steps_(std::min(steps, kMost)) {}

  double next(double value) LITHE_RT {
    if (steps_ == 0) return value;
    const double due = underway_[at_];
    underway_[at_] = value;
    at_ = (at_ + 1) % steps_;
    return due;
  }
  void clear() LITHE_RT { underway_.fill(0); }

 private:
  std::size_t steps_, at_ = 0;
  std::array<double, kMost> underway_{};
};

// Truth of one joint. With [plant] ideal = true there are no errors and no payload.
struct Truth {
  robot::PlantConfig plant;  // payload included
  DriveErrors drive;
  double payload_kg = 0;
  // mgl of an independent joint in the torque that its drive reports: the value that a measurement can find.
  double mgl_told_nm = 0;
};

// The same result for the same file.
// Contract: never in the tick
Truth draw_truth(const robot::RobotConfig& config, const robot::JointConfig& joint);

}  // namespace lithe::hal::sim
