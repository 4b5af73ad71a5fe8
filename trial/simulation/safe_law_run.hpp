// SPDX-License-Identifier: Apache-2.0
// The safe law alone on the simulated robot: once, when a robot starts.
#pragma once

#include <string>

#include "spine/core/result.hpp"
#include "spine/robot/config.hpp"

namespace lithe::trial {

// Joints that move at half of velocity_max_rad_s are stopped by the safe law, with the bus delay and the errors that
// the robot file gives its simulation, and with the noise, the push and the late tick of the rough run. "" or, when
// a joint shakes or does not slow down, which gain of which joint, and what to write instead. A joint behind a real bus
// is simulated with its declared inertia and drive_lag_s; without a declared inertia it is not judged: what it is was
// only assumed. Errors: the robot cannot be simulated.
Result<std::string> run_safe_law(const robot::RobotConfig& robot);

}  // namespace lithe::trial
