// SPDX-License-Identifier: Apache-2.0
// A plan as JSON, for programs.
#pragma once

#include <nlohmann/json.hpp>
#include <string_view>

#include "supervisor/bus/plan.hpp"

namespace lithe::bus {

using Json = nlohmann::ordered_json;

std::string_view word(robot::BusKind kind);
std::string_view word(robot::DeviceKind kind);

// Loads are shares of 1; what has no end (a bus without devices) is null.
Json to_json(const Plan& plan, const robot::RobotConfig& robot);

}  // namespace lithe::bus
