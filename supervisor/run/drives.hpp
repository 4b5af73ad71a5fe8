// SPDX-License-Identifier: Apache-2.0
// What the drives themselves last said about being on or off.
#pragma once

#include <string>

#include "spine/robot/config.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::control {

enum class Drives { driven, damped, off };

// The state of the drive that is furthest from off. A drive that did not answer in this record counts as driven:
// nothing is known about it. Damped: it brakes its joint by itself, on the e-stop or because its watchdog ran out.
// `robot` tells what kind each drive is: their modes are numbered differently.
Drives drives_of(const robot::RobotConfig& robot, const wire::Telemetry& now);

// Names of the joints whose drives are not off, for a message.
std::string joints_not_off(const robot::RobotConfig& robot, const wire::Telemetry& now);

}  // namespace lithe::control
