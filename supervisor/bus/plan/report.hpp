// SPDX-License-Identifier: Apache-2.0
// A plan as JSON, for programs.
#pragma once

#include <nlohmann/json.hpp>

#include "supervisor/bus/plan/plan.hpp"

namespace lithe::bus {

using Json = nlohmann::ordered_json;

// Loads are shares of 1; an unlimited value (a bus without devices) is null.
Json to_json(const Plan& plan, const robot::RobotConfig& robot);

}  // namespace lithe::bus
