// SPDX-License-Identifier: Apache-2.0
// What the shield of a robot covers, and how its status tells it.
#pragma once

#include <vector>

#include "host/tune/shield/shield.hpp"
#include "spine/robot/cores/cpu_plan.hpp"
#include "supervisor/core/answer.hpp"

namespace lithe::control {

// The cores of the Spine and of a Transport that shares none; empty when the Spine shares its core.
std::vector<int> cores_to_shield(const robot::CpuPlan& plan);

// For status; null without a shield.
Json shield_json(const host::Shield* shield);

}  // namespace lithe::control
