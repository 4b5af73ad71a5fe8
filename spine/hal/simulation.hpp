// SPDX-License-Identifier: Apache-2.0
// Interface to the simulated devices of a robot. spine/hal/sim implements it; a program that drives real buses only
// does not link that.
#pragma once

#include <cstddef>
#include <memory>

#include "spine/core/rt.hpp"
#include "spine/hal/bus/pi3hat/imu.hpp"
#include "spine/hal/core/bus.hpp"
#include "spine/robot/config.hpp"

namespace lithe::hal {

// Contract: to_start() RT; the rest never in the tick · outlives its buses
class Simulation {
 public:
  Simulation() = default;
  Simulation(const Simulation&) = delete;
  Simulation& operator=(const Simulation&) = delete;
  virtual ~Simulation() = default;
  // A bus in memory with the simulated devices of bus `index` at its far end.
  virtual std::unique_ptr<Bus> open_bus(const robot::RobotConfig& config, std::size_t index) = 0;
  // The IMU of a simulated board.
  virtual ImuSource& imu() = 0;
  // Puts every joint back to its start, at rest.
  virtual void to_start() LITHE_RT = 0;
};

}  // namespace lithe::hal
