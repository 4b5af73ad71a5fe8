// SPDX-License-Identifier: Apache-2.0
// What main does with the code arena that the supervisor hands over.
#pragma once

#include <memory>

#include "spine/core/result.hpp"
#include "spine/load/arena_store.hpp"
#include "spine/robot/config.hpp"

namespace lithe {

// Attaches it, and keeps its descriptor for a supervisor that adopts this process: readable, never writable. nullptr
// when the robot file asks for dlopen; the Error is a sentence for the notes, and laws are loaded with dlopen.
// Contract: once, before the first tick
Result<std::unique_ptr<load::ArenaStore>> attach_code_arena(const robot::RobotConfig& robot);

}  // namespace lithe
