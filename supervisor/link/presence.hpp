// SPDX-License-Identifier: Apache-2.0
// Who lives for a robot: a Spine that ticks, a supervisor that answers. Both are looked for, neither is told anything.
#pragma once

#include <sys/types.h>

#include <optional>
#include <set>
#include <string>
#include <variant>

#include "supervisor/link/client.hpp"
#include "supervisor/core/answer.hpp"

namespace lithe::control {

struct Presence {
  enum class Supervisor { none, starting, answers, stopped, silent };
  std::string robot;
  Supervisor supervisor = Supervisor::none;
  pid_t supervisor_pid = 0;                  // 0 = unknown
  std::optional<pid_t> spine_pid;            // nothing: no Spine lives; 0 = unknown
  bool ticks = false;                        // its tick went on while we looked
  std::string mode = "-", fault = "-", law;  // of its last tick
  std::uint64_t tick = 0;
  std::string unreadable;  // why nobody can tell what its Spine does: of another build, no right
  std::string config;      // path of its robot file; empty = unknown

  bool is_there() const { return supervisor != Supervisor::none || spine_pid.has_value(); }
};

const char* word(Presence::Supervisor supervisor);

// Takes up to 2 s where a supervisor says nothing, and longer where the machine gives it no time.
Presence look_for(const std::string& robot);

// Its supervisor, who answers; or why nothing can be asked of it, and what leads on.
std::variant<Client, swap::Refusal> reach(const std::string& robot);

// True for what reach() refuses with: the request has come to nobody.
bool is_nobody(const swap::Refusal& refusal);

swap::Json presence_json(const Presence& presence);

// Robots that have a control segment, alive or not.
std::set<std::string> robots_with_memory();

}  // namespace lithe::control
