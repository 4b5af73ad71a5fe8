// SPDX-License-Identifier: Apache-2.0
// Whether the drives are on or off, from their last replies.
#pragma once

#include <string>

#include "spine/robot/config.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::control {

enum class Drives { driven, damped, off };

// The most active state of all drives. A drive that did not answer in this record counts as driven, because its state
// is unknown. Damped: the drive brakes its joint by itself, after an e-stop or a watchdog timeout. A drive with a fault
// is off.
Drives drives_of(const wire::Telemetry& now);

// Names of the joints whose drives are not off, for a message.
std::string joints_not_off(const robot::RobotConfig& robot, const wire::Telemetry& now);

}  // namespace lithe::control
