// SPDX-License-Identifier: Apache-2.0
// Makes the Actuators of a robot file: opens its buses, makes its drivers.
#pragma once

#include <cstddef>
#include <functional>
#include <memory>

#include "spine/core/result.hpp"
#include "spine/core/rt.hpp"
#include "spine/hal/actuators.hpp"
#include "spine/hal/core/board.hpp"
#include "spine/hal/core/bus.hpp"
#include "spine/hal/core/tap.hpp"
#include "spine/hal/open_bus.hpp"
#include "spine/robot/config.hpp"

namespace lithe::hal {

// The simulated devices of a robot. spine/hal/sim implements it; a program that drives real buses only does not link
// that.
// Contract: to_start() RT; the rest never in the tick · outlives its buses
class Simulation : public Interface {
 public:
  // A bus in memory with the simulated devices of bus `index` at its far end.
  virtual std::unique_ptr<Bus> open_bus(const robot::RobotConfig& config, std::size_t index) = 0;
  // The IMU of a simulated board.
  virtual ImuSource& imu() = 0;
  // Puts every joint back to its start, at rest.
  virtual void to_start() LITHE_RT = 0;
};

using MakeSimulation = std::function<Result<std::unique_ptr<Simulation>>(const robot::RobotConfig&)>;

struct HardwareOptions {
  MakeSimulation make_simulation{};  // for buses of kind "loop"; empty: a robot that has one is refused
  FrameTap* tap = nullptr;           // gets the frames of all buses with their index in the file; null: no tap
  OpenBoard open_board{};            // replaces the board, for tests; empty: the board of this machine
};

// Opens every bus and device of the robot. `config` is as load_robot returned it, which has checked it.
// Contract: never in the tick
Result<std::unique_ptr<Actuators>> open_actuators(const robot::RobotConfig& config, HardwareOptions options = {});

}  // namespace lithe::hal
