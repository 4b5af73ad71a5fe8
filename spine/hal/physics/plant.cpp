// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/physics/plant.hpp"

#include <numbers>

#include "spine/hal/physics/truth.hpp"

namespace lithe::hal::sim {

double cogging_phase_rad(std::uint64_t seed) { return 2 * std::numbers::pi * Draws(seed).share(); }

Plant::Plant(const PlantParams& params)
    : params_(params),
      lag_gain_(params.torque_lag_s > 0 ? 1 - std::exp(-kStepS / params.torque_lag_s) : 1),
      step_per_inertia_(kStepS / params.inertia_kg_m2),
      viscous_gain_(1 / (1 + step_per_inertia_ * params.viscous_nm_s_rad)),
      cogging_per_rad_(params.cogging_per_rev),
      phase_rad_(cogging_phase_rad(params.seed)),
      position_rad_(params.initial_position_rad) {}

}  // namespace lithe::hal::sim
