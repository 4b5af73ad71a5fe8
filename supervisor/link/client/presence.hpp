// SPDX-License-Identifier: Apache-2.0
// Finds the live processes of a robot: a Spine that ticks, a supervisor that answers. Read-only for both.
#pragma once

#include <sys/types.h>

#include <optional>
#include <set>
#include <string>
#include <variant>

#include "supervisor/core/answer.hpp"
#include "supervisor/link/client/client.hpp"

namespace lithe::control {

struct Presence {
  enum class Supervisor { none, starting, answers, stopped, silent };
  std::string robot;
  Supervisor supervisor = Supervisor::none;
  pid_t supervisor_pid = 0;                  // 0 = unknown
  std::optional<pid_t> spine_pid;            // nothing: no Spine lives; 0 = unknown
  bool ticks = false;                        // the tick counter moved during the check
  std::string mode = "-", fault = "-", law;  // of its last tick
  std::uint64_t tick = 0;
  std::string unreadable;  // why the Spine's state cannot be read: another build, no permission
  std::string config;      // path of its robot file; empty = unknown

  bool is_there() const { return supervisor != Supervisor::none || spine_pid.has_value(); }
};

const char* word(Presence::Supervisor supervisor);

// Takes up to 2 s when a supervisor does not answer, and longer when it gets no processor time.
Presence look_for(const std::string& robot);

// A connection to a supervisor that answers; otherwise a Refusal with the reason and the next step.
std::variant<Client, Refusal> reach(const std::string& robot);

// True for the codes of reach(): the request was not delivered.
bool is_unreachable(const Refusal& refusal);

Json presence_json(const Presence& presence);

// Robots that have a control segment, alive or not.
std::set<std::string> robots_with_memory();

}  // namespace lithe::control
