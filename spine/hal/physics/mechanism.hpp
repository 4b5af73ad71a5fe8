// SPDX-License-Identifier: Apache-2.0
// Interface of a mechanism that couples several joints.
#pragma once

#include <cstddef>
#include <span>

#include "spine/core/rt.hpp"

namespace lithe::hal::sim {

// Simulates in steps of Plant::kStepNs. Same inputs, same motion, to the bit.
// Contract: RT · one thread · no clock of its own
class Mechanism {
 public:
  Mechanism() = default;
  Mechanism(const Mechanism&) = delete;
  Mechanism& operator=(const Mechanism&) = delete;
  virtual ~Mechanism() = default;

  // Simulates Plant::kStepNs. One finite torque per joint; extra values are ignored.
  virtual void step(std::span<const double> wanted_nm) LITHE_RT = 0;

  // Puts every joint back to its start, at rest.
  virtual void to_start() LITHE_RT = 0;

  virtual std::size_t joints() const LITHE_RT = 0;
  virtual double position_rad(std::size_t joint) const LITHE_RT = 0;
  virtual double velocity_rad_s(std::size_t joint) const LITHE_RT = 0;
  virtual double torque_nm(std::size_t joint) const LITHE_RT = 0;  // of the motor, at the joint

  // The inertia that a drive at this joint is tuned for: everything that turns with it, in a usual pose.
  // Contract: never in the tick
  virtual double inertia_kg_m2(std::size_t joint) const = 0;
};

}  // namespace lithe::hal::sim
