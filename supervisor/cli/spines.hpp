// SPDX-License-Identifier: Apache-2.0
// Robots by their shared memory, with or without a supervisor.
#pragma once

#include <set>
#include <string>
#include <vector>

#include "supervisor/field/place.hpp"

namespace lithe::cli {

// Robots that have a control segment, alive or not.
std::set<std::string> robots_with_memory();

// Robots whose Spine lives and works on one of the chosen buses: "robot 'arm' (bus 'can0')".
// Contract: not RT · reads the robot files of all that run
std::vector<std::string> spines_on(const field::Choice& choice);

}  // namespace lithe::cli
