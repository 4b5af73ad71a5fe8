// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/physics/coupled_drive.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace lithe::hal::sim {

CoupledDrive::CoupledDrive(const Encoder& encoder, const JointTransform& joint, const PlantParams& plant,
                           const DriveErrors& errors)
    : joint_(joint), plant_(plant), errors_(errors), encoder_(encoder) {
  to_start();
}

void CoupledDrive::to_start() LITHE_RT {
  plant_.to_start();
  tracked_rev_ = joint_.motor_rev(plant_.position_rad());
  measure();
  tracked_rev_ = encoder_rev_;
  velocity_rev_s_ = 0;
}

void CoupledDrive::advance(std::int64_t now_ns) LITHE_RT {
  if (!started_) time_ns_ = now_ns;
  started_ = true;
  const std::int64_t lag_ns = now_ns - time_ns_;
  if (lag_ns <= 0) return;
  const std::int64_t steps = std::min(lag_ns, kMaxCatchUpNs) / Plant::kStepNs;
  for (std::int64_t i = 0; i < steps; ++i) {
    step();
    time_ns_ += Plant::kStepNs;
  }
  if (lag_ns > kMaxCatchUpNs) skip(now_ns);
}

void CoupledDrive::skip(std::int64_t now_ns) LITHE_RT {
  time_ns_ += std::max<std::int64_t>(now_ns - time_ns_, 0) / Plant::kStepNs * Plant::kStepNs;
  on_skip();
}

void CoupledDrive::move(double motor_nm) LITHE_RT {
  plant_.step(errors_.given_nm(motor_nm * joint_.gear()));
  errors_.step();
  measure();
}

void CoupledDrive::measure() LITHE_RT {
  constexpr double kNothing = 1e-12;
  const double rev = joint_.motor_rev(plant_.position_rad() + errors_.encoder_error_rad()) + offset_rev_;
  encoder_rev_ = std::floor(rev * encoder_.counts_per_rev) / encoder_.counts_per_rev;
  const double pole = 2 * std::numbers::pi * encoder_.filter_hz;
  const double error_rev = encoder_rev_ - tracked_rev_;
  velocity_rev_s_ += Plant::kStepS * pole * pole * error_rev;
  tracked_rev_ += Plant::kStepS * (velocity_rev_s_ + 2 * pole * error_rev);
  if (std::abs(velocity_rev_s_) < kNothing) velocity_rev_s_ = 0;
}

}  // namespace lithe::hal::sim
