// SPDX-License-Identifier: Apache-2.0
// One joint of a simulated robot: a pendulum with the friction, lag and sensors of a real one.
#pragma once

#include <cstdint>

#include "spine/core/rt.hpp"
#include "spine/robot/config.hpp"

namespace lithe::hal {

// J th'' = tau - mgl sin(th) - b w - A cos(N th) - friction, tau following the drive with a first-order lag.
// Friction is Coulomb's: it opposes motion, and holds the joint while the other torques stay below it.
// Integration: semi-implicit Euler in fixed inner steps of 50 us, friction applied as an impulse that may stop the
// joint but never turn it round, so sticking is exact and not a steep tanh.
// Contract: RT · deterministic: the same calls give the same bits
class Plant {
 public:
  static constexpr std::int64_t kStepNs = 50'000;

  explicit Plant(const robot::PlantConfig& config);

  // One inner step with `torque_nm` asked of the drive (joint side).
  void step(double torque_nm) LITHE_RT;

  double position_rad() const LITHE_RT { return position_rad_; }
  double velocity_rad_s() const LITHE_RT { return velocity_rad_s_; }
  double torque_nm() const LITHE_RT { return torque_nm_; }  // what the drive really applies, after its lag
  // Kinetic and potential energy [J], zero hanging at rest.
  double energy_j() const LITHE_RT;

 private:
  robot::PlantConfig config_;
  double lag_gain_;  // share of the way to the asked torque made in one step
  double position_rad_;
  double velocity_rad_s_ = 0;
  double torque_nm_ = 0;
};

}  // namespace lithe::hal
