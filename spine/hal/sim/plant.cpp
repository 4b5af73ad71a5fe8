// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/sim/plant.hpp"

#include <cmath>

#include "spine/core/time.hpp"

namespace lithe::hal {
namespace {

constexpr double kStepS = static_cast<double>(Plant::kStepNs) / static_cast<double>(kNsPerS);

}  // namespace

Plant::Plant(const robot::PlantConfig& config)
    : config_(config),
      lag_gain_(config.torque_lag_s > 0 ? 1.0 - std::exp(-kStepS / config.torque_lag_s) : 1.0),
      position_rad_(config.initial_position_rad) {}

void Plant::step(double torque_nm) LITHE_RT {
  torque_nm_ += (torque_nm - torque_nm_) * lag_gain_;
  const double driven_nm =
      torque_nm_ - config_.mgl_nm * std::sin(position_rad_) -
      (config_.cogging_nm != 0 ? config_.cogging_nm * std::cos(config_.cogging_per_rev * position_rad_) : 0.0);
  // The viscous part implicitly: stable however large b is.
  const double free_rad_s = (velocity_rad_s_ + kStepS * driven_nm / config_.inertia_kg_m2) /
                            (1.0 + kStepS * config_.viscous_nm_s_rad / config_.inertia_kg_m2);
  const double friction_rad_s = kStepS * config_.coulomb_nm / config_.inertia_kg_m2;
  velocity_rad_s_ = std::abs(free_rad_s) <= friction_rad_s ? 0.0 : free_rad_s - std::copysign(friction_rad_s, free_rad_s);
  position_rad_ += kStepS * velocity_rad_s_;
}

double Plant::energy_j() const LITHE_RT {
  return 0.5 * config_.inertia_kg_m2 * velocity_rad_s_ * velocity_rad_s_ +
         config_.mgl_nm * (1.0 - std::cos(position_rad_));
}

}  // namespace lithe::hal
