// SPDX-License-Identifier: Apache-2.0
// Makes the Actuators of a robot file: opens its buses, makes drivers and simulated devices.
#pragma once

#include <memory>
#include <vector>

#include "spine/core/result.hpp"
#include "spine/hal/actuators.hpp"
#include "spine/hal/bus/pi3hat/pi3hat_port.hpp"
#include "spine/hal/core/tap.hpp"
#include "spine/robot/config.hpp"

namespace lithe::hal {

// Opens every bus and device of the robot. `pi3hat`: replaces the board (for tests); null = the board of this machine.
// `tap` gets the frames of all buses with their index in the file; null = no tap.
// Contract: never in the tick
Result<std::unique_ptr<Actuators>> open_actuators(const robot::RobotConfig& config,
                                                  std::unique_ptr<Pi3hatPort> pi3hat = nullptr,
                                                  FrameTap* tap = nullptr);

class BusNode;

// The same robot with every bus and device simulated, whatever the file says. `far_ends`: for each bus the simulated
// devices, which outlive the actuators; empty = made from the file.
// Contract: never in the tick
Result<std::unique_ptr<Actuators>> simulate_actuators(robot::RobotConfig config,
                                                      const std::vector<BusNode*>& far_ends = {});

}  // namespace lithe::hal
