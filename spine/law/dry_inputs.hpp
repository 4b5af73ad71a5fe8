// SPDX-License-Identifier: Apache-2.0
// Inputs of a dry run: used by lawd and by the Loader's rehearsal.
#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <numbers>

#include "lithe/law.hpp"

namespace lithe::law {

// The first steps see a robot at rest at zero, where a division by a velocity fails; the others see one that moves.
inline constexpr std::uint64_t kDryStepsAtRest = 3;

// Step k of a healthy robot: at rest, then a slow sine that the joints follow with a small lag. At first no sensor is
// valid (NaN), as after a start; then all are valid.
// Contract: off the tick · pure · `tick` holds nothing but earlier dry inputs
inline void dry_input(Tick& tick, std::uint64_t k, std::uint32_t joints) {
  tick.tick = k;
  tick.dt_s = 1e-3;
  tick.t_s = static_cast<double>(k) * tick.dt_s;
  tick.t_ns = static_cast<std::int64_t>(k) * 1'000'000;
  tick.joints = joints;
  tick.sample_age_s = tick.dt_s;
  tick.sensor.fill(kAbsent);
  tick.input_age_s = tick.dt_s;
  if (k < kDryStepsAtRest) return;
  for (std::size_t i = 0; i < kMaxSensors; ++i) tick.sensor[i] = 1 + 0.5 * std::sin(tick.t_s + static_cast<double>(i));
  for (std::uint32_t j = 0; j < joints; ++j) {
    const double w = std::numbers::pi, phase = w * tick.t_s + 0.1 * j;
    tick.setpoint_position_rad[j] = 0.5 * std::sin(phase);
    tick.setpoint_velocity_rad_s[j] = 0.5 * w * std::cos(phase);
    tick.setpoint_acceleration_rad_s2[j] = -0.5 * w * w * std::sin(phase);
    tick.position_rad[j] = 0.48 * std::sin(phase - 0.05);
    tick.velocity_rad_s[j] = 0.48 * w * std::cos(phase - 0.05);
    tick.torque_nm[j] = 0.05 * std::sin(phase);
  }
}

// False when an output is not finite; `text` then names the first one.
// Contract: off the tick · allocates nothing
inline bool outputs_are_finite(const Effort& effort, const std::array<double, kMaxProbes>& probes, const LitheLaw& law,
                               std::uint32_t joints, char* text, std::size_t size) {
  const struct {
    const char* name;
    const JointArray& values;
  } fields[] = {{"torque_nm", effort.torque_nm},
                {"position_rad", effort.position_rad},
                {"velocity_rad_s", effort.velocity_rad_s},
                {"kp_nm_rad", effort.kp_nm_rad},
                {"kd_nm_s_rad", effort.kd_nm_s_rad}};
  for (std::uint32_t j = 0; j < joints; ++j) {
    for (const auto& field : fields) {
      const bool absent = &field.values == &effort.position_rad && std::isnan(field.values[j]);
      if (absent || std::isfinite(field.values[j])) continue;
      std::snprintf(text, size, "%s[%u]", field.name, j);
      return false;
    }
  }
  for (std::uint32_t i = 0; i < law.probe_count; ++i) {
    if (std::isfinite(probes[i])) continue;
    std::snprintf(text, size, "probe %s", law.probes[i]);
    return false;
  }
  return true;
}

}  // namespace lithe::law
