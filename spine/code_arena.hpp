// SPDX-License-Identifier: Apache-2.0
// What main does with the code arena that the supervisor hands over.
#pragma once

#include <memory>

#include "spine/core/result.hpp"
#include "spine/load/law_store.hpp"
#include "spine/robot/config.hpp"

namespace lithe {

// Attaches the arena, and keeps a read-only descriptor of it for a supervisor that adopts this process later. nullptr
// when the robot file asks for dlopen. After an Error, a sentence for the notes, laws are loaded with dlopen, too.
// Contract: once, before the first tick
Result<std::unique_ptr<load::ArenaStore>> attach_code_arena(const robot::RobotConfig& robot);

}  // namespace lithe
