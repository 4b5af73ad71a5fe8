// SPDX-License-Identifier: Apache-2.0
// Physics of one joint (inertia, gravity, dry friction, motor lag), and the interface of several joints.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <numbers>
#include <span>

#include "spine/core/pinned.hpp"
#include "spine/core/rt.hpp"
#include "spine/hal/bus/loop/draws.hpp"
#include "spine/hal/core/board.hpp"

namespace lithe::hal::sim {

// Joint coordinates: angle 0 hangs straight down, gravity pulls with -mgl_nm * sin(angle).
struct PlantParams {
  double inertia_kg_m2 = 2.5e-3;
  double mgl_nm = 0.0;
  double viscous_nm_s_rad = 0.0;
  double coulomb_nm = 0.0;  // dry friction, also what holds the joint at rest
  double cogging_nm = 0.0;  // amplitude
  std::uint32_t cogging_per_rev = 84;
  double stribeck_nm = 0.0;     // dry friction at rest, above coulomb_nm
  double stribeck_rad_s = 0.1;  // at this speed 1/e of it is left
  double torque_lag_s = 0.0;
  double torque_max_nm = 1e9;  // of the motor, at the joint
  double initial_position_rad = 0.0;
  std::uint64_t seed = 1;  // of the cogging's phase
};

// Dry friction at a speed: Coulomb's, and above it at low speed Stribeck's, which falls as exp(-(v/v_s)^2) (the form of
// Armstrong-Helouvry, Dupont and Canudas de Wit, 1994).
inline double dry_friction_nm(double coulomb_nm, double stribeck_nm, double stribeck_rad_s, double velocity_rad_s)
    LITHE_RT {
  if (stribeck_nm == 0) return coulomb_nm;
  const double ratio = velocity_rad_s / stribeck_rad_s;
  constexpr double kNothingLeft = 36;  // its exponent
  return ratio * ratio < kNothingLeft ? coulomb_nm + stribeck_nm * std::exp(-ratio * ratio) : coulomb_nm;
}

// Phase of a motor's cogging: random, the same for the same seed.
inline double cogging_phase_rad(std::uint64_t seed) { return 2 * std::numbers::pi * Draws(seed).share(); }

//   inertia * angle'' = torque - mgl sin(angle) - viscous * velocity - friction - cogging,  torque' = (wanted - torque)
//   / lag
//
// Semi-implicit Euler in steps of 50 us: the integration neither adds nor removes energy, and viscous friction of any
// size is stable. Dry friction is Coulomb's law without smoothing: a joint that would reverse within a step stops, and
// a joint at rest stays until the other torques exceed coulomb_nm + stribeck_nm. Same inputs, same motion, to the bit.
// Contract: RT · one thread · no clock of its own
class Plant {
 public:
  static constexpr std::int64_t kStepNs = 50'000;
  static constexpr double kStepS = 1e-9 * static_cast<double>(kStepNs);

  // The share of the way to the wanted torque that a motor with this lag goes in a step.
  static double lag_gain(double lag_s) { return lag_s > 0 ? 1 - std::exp(-kStepS / lag_s) : 1; }

  // The torque of a motor with that gain, a step after it was `torque_nm`.
  static double lagged_nm(double torque_nm, double wanted_nm, double most_nm, double lag_gain) LITHE_RT {
    constexpr double kNothing = 1e-15;  // a torque below it becomes 0: denormal numbers are slow
    torque_nm += lag_gain * (std::clamp(wanted_nm, -most_nm, most_nm) - torque_nm);
    return std::abs(torque_nm) < kNothing ? 0 : torque_nm;
  }

  explicit Plant(const PlantParams& params)
      : params_(params),
        lag_gain_(lag_gain(params.torque_lag_s)),
        step_per_inertia_(kStepS / params.inertia_kg_m2),
        viscous_gain_(1 / (1 + step_per_inertia_ * params.viscous_nm_s_rad)),
        phase_rad_(cogging_phase_rad(params.seed)),
        position_rad_(params.initial_position_rad) {}

  // Simulates kStepNs with this commanded motor torque (finite).
  void step(double wanted_nm) LITHE_RT {
    wanted_nm_ = wanted_nm;
    if (coupled_) return;
    torque_nm_ = lagged_nm(torque_nm_, wanted_nm, params_.torque_max_nm, lag_gain_);
    double load_nm = torque_nm_ - params_.mgl_nm * std::sin(position_rad_);
    if (params_.cogging_nm != 0)
      load_nm -= params_.cogging_nm * std::sin(params_.cogging_per_rev * position_rad_ + phase_rad_);
    const double moved_by_nm = velocity_rad_s_ != 0 ? velocity_rad_s_ : load_nm;  // only its sign counts
    const double friction_nm =
        dry_friction_nm(params_.coulomb_nm, params_.stribeck_nm, params_.stribeck_rad_s, velocity_rad_s_);
    if (velocity_rad_s_ == 0 && std::abs(load_nm) <= friction_nm) return;
    const double before_rad_s = velocity_rad_s_;
    velocity_rad_s_ += step_per_inertia_ * (load_nm - std::copysign(friction_nm, moved_by_nm));
    velocity_rad_s_ *= viscous_gain_;  // implicit, so stable for any size
    if (friction_nm > 0 && before_rad_s * velocity_rad_s_ < 0) velocity_rad_s_ = 0;
    position_rad_ += kStepS * velocity_rad_s_;
  }

  double position_rad() const LITHE_RT { return position_rad_; }
  double velocity_rad_s() const LITHE_RT { return velocity_rad_s_; }
  double torque_nm() const LITHE_RT { return torque_nm_; }

  // From then on step() only stores the commanded torque, and a Coupling moves the joint.
  void couple() { coupled_ = true; }
  double wanted_nm() const LITHE_RT { return wanted_nm_; }
  void follow(double position_rad, double velocity_rad_s, double torque_nm) LITHE_RT {
    position_rad_ = position_rad;
    velocity_rad_s_ = velocity_rad_s;
    torque_nm_ = torque_nm;
  }

  // Puts the joint back to its start, at rest. A coupled joint follows its mechanism.
  void to_start() LITHE_RT {
    if (!coupled_) follow(params_.initial_position_rad, 0, 0);
  }

  // Sets the joint's position, at rest.
  // Contract: tests and set-up
  void place(double position_rad) LITHE_RT { follow(position_rad, 0, torque_nm_); }

 private:
  PlantParams params_;
  double lag_gain_;
  double step_per_inertia_;
  double viscous_gain_;
  double phase_rad_;
  double position_rad_;
  double velocity_rad_s_ = 0;
  double torque_nm_ = 0;
  double wanted_nm_ = 0;
  bool coupled_ = false;
};

// Of an IMU at rest, level: an accelerometer measures gravity upwards.
inline constexpr std::array<double, kImuChannels> kLevelImu{1, 0, 0, 0, 0, 0, 0, 0, 0, 9.80665};

// A mechanism that couples several joints. Simulates in steps of Plant::kStepNs. Same inputs, same motion, to the bit.
// Contract: RT · one thread · no clock of its own
class Mechanism : public Interface {
 public:
  // Simulates Plant::kStepNs. One finite torque per joint; extra values are ignored.
  virtual void step(std::span<const double> wanted_nm) LITHE_RT = 0;

  // Puts every joint back to its start, at rest.
  virtual void to_start() LITHE_RT = 0;

  virtual std::size_t joints() const LITHE_RT = 0;
  virtual double position_rad(std::size_t joint) const LITHE_RT = 0;
  virtual double velocity_rad_s(std::size_t joint) const LITHE_RT = 0;
  virtual double torque_nm(std::size_t joint) const LITHE_RT = 0;  // of the motor, at the joint

  // Attitude, angular rate and acceleration of an IMU on its base, as ImuReading::value has them. A base that is fixed
  // and level has always the same.
  virtual void read_imu(std::array<double, kImuChannels>& out) const LITHE_RT { out = kLevelImu; }

  // The inertia that a drive at this joint is tuned for: everything that turns with it, in a usual pose.
  // Contract: never in the tick
  virtual double inertia_kg_m2(std::size_t joint) const = 0;
};

}  // namespace lithe::hal::sim
