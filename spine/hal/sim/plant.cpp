// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/sim/plant.hpp"

#include <numbers>

namespace lithe::hal::sim {

// SplitMix64.
double cogging_phase_rad(std::uint64_t seed) {
  std::uint64_t z = seed + 0x9e3779b97f4a7c15;
  z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9;
  z = (z ^ (z >> 27)) * 0x94d049bb133111eb;
  return 2 * std::numbers::pi * static_cast<double>((z ^ (z >> 31)) >> 11) * 0x1p-53;
}

Plant::Plant(const PlantParams& params)
    : params_(params),
      lag_gain_(params.torque_lag_s > 0 ? 1 - std::exp(-kStepS / params.torque_lag_s) : 1),
      step_per_inertia_(kStepS / params.inertia_kg_m2),
      viscous_gain_(1 / (1 + step_per_inertia_ * params.viscous_nm_s_rad)),
      cogging_per_rad_(params.cogging_per_rev),
      phase_rad_(cogging_phase_rad(params.seed)),
      position_rad_(params.initial_position_rad) {}

}  // namespace lithe::hal::sim
