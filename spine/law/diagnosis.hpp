// SPDX-License-Identifier: Apache-2.0
// What is wrong with a law's control of one joint. Computed from measured values, never from the law's text. For the
// trial and the supervisor, off the tick.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>

namespace lithe::law {

// Sums over a run.
// Contract: plain bytes · any bytes are safe to read
struct JointSums {
  static constexpr std::size_t kValues = 5;  // setpoint [rad], position [rad], its velocity, setpoint's, torque [N m]
  std::uint32_t ticks = 0;
  std::uint32_t at_limit = 0;            // ticks in which the law wanted torque_max_nm or more
  std::uint32_t at_limit_unwinding = 0;  // of them: it pushed away from the setpoint, less in each tick
  std::uint32_t reserved = 0;
  double last_nm = 0;
  double most_nm = 0;  // wanted
  std::array<double, kValues> sum{};
  std::array<double, kValues*(kValues + 1) / 2> product{};

  struct Sample {
    double setpoint_rad, position_rad, velocity_rad_s, setpoint_rad_s, wanted_nm;
  };
  void see(const Sample& sample, double torque_max_nm);
};

struct JointSeen {
  const char* joint;  // its name
  double torque_max_nm;
  double swing_hz = 0;               // of an oscillation that was found; 0 = none
  bool refused = false;              // stopped, clamped or shaking: then its gains are looked at
  std::span<const double> params{};  // the law's values
};

struct Diagnosis {
  enum class Kind : std::uint8_t {
    none,  // the evidence is not clear
    no_torque,
    stalled,
    wrong_sign,
    wrong_damping_sign,
    degrees,
    no_damping,
    gain_too_high,
    wind_up,
    steady_load
  };
  Kind kind = Kind::none;
  std::array<char, 280> text{};  // what was measured, and what to change; "" for none
};

Diagnosis diagnose(const JointSums& sums, const JointSeen& seen);

}  // namespace lithe::law
