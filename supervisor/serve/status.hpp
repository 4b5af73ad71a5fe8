// SPDX-License-Identifier: Apache-2.0
// The robot's status as one JSON document.
#pragma once

#include <cstdint>
#include <string>

#include "spine/robot/config.hpp"
#include "supervisor/core/answer.hpp"
#include "supervisor/link/spine/spine_link.hpp"

namespace lithe::control {

// What a drive of this kind reports: its state, and its fault with the code.
std::string told_by_drive(robot::DeviceKind kind, std::uint32_t joint_status);

// `robot`: gives the kind of each joint's drive.
Json status_json(const SpineLink& spine, const robot::RobotConfig& robot);
// {"law","law_id","params":[{"name","value","min","max"}]} of the running law.
Answer params_json(const SpineLink& spine);
// Laws loaded in the Spine: [{"law","law_id","active","params":[...],"probes":[...]}]
Json resident_json(const SpineLink& spine);

// [{"level", "text"}], the worst first; empty = no alarm. "stop": the robot or a joint is stopped or broken, or no
// supervisor runs. "warn": a condition that can lead to a stop, or that weakens a guarantee. `status`: the answer of
// the verb `status`; a missing field raises no alarm.
// Contract: pure
Json alarms_of(const Json& status);

}  // namespace lithe::control
