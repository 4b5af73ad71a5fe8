// SPDX-License-Identifier: Apache-2.0
// Derives the list of alarms from a robot's status.
#pragma once

#include "supervisor/core/answer.hpp"

namespace lithe::control {

// [{"level", "text"}], the worst first; empty = no alarm. "stop": the robot or a joint is stopped or broken, or no
// supervisor runs. "warn": a condition that can lead to a stop, or that weakens a guarantee. `status`: the answer of
// the verb `status`; a missing field raises no alarm.
// Contract: pure
Json alarms_of(const Json& status);

}  // namespace lithe::control
