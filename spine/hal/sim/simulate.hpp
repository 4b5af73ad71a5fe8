// SPDX-License-Identifier: Apache-2.0
// Makes the Actuators of a robot file with simulated devices.
#pragma once

#include <memory>

#include "spine/core/result.hpp"
#include "spine/hal/actuators.hpp"
#include "spine/hal/robot_hardware.hpp"
#include "spine/hal/simulation.hpp"
#include "spine/robot/config.hpp"

namespace lithe::hal::sim {

// The simulated devices of a robot file. The error: the plant cannot be opened, or it joins simulated and real joints.
// Contract: never in the tick
Result<std::unique_ptr<Simulation>> make_simulation(const robot::RobotConfig& config);

// As hal::open_actuators; buses of kind "loop" have simulated devices.
// Contract: never in the tick
Result<std::unique_ptr<Actuators>> open_actuators(const robot::RobotConfig& config, FrameTap* tap = nullptr);

// The same robot with every bus and device simulated, whatever the file says.
// Contract: never in the tick
Result<std::unique_ptr<Actuators>> simulate_actuators(robot::RobotConfig config);

}  // namespace lithe::hal::sim
