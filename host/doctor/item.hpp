// SPDX-License-Identifier: Apache-2.0
// The checklist of `lithe doctor` as one table. A check reads, judges, and names what it has read.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "host/doctor/measure/measured.hpp"
#include "host/read/files.hpp"
#include "host/read/tasks.hpp"
#include "spine/core/host/cores.hpp"

namespace lithe::host {

enum class State : std::uint8_t { ok, not_applicable, unknown, warn, fail };
const char* word(State state);

struct Evidence {
  std::string path;
  std::string value;  // as read; or why there is none: "(absent)", "(Permission denied)"
};

struct Finding {
  State state = State::unknown;
  std::string words;  // what was found, in one sentence
  std::vector<Evidence> evidence;
};

// What the checks judge: one core of one machine.
struct Subject {
  HostFiles files;
  int cpu = 0;
  std::vector<int> online;
  IsolatedCores isolated;  // for this process, and what it starts
  Tasks tasks;
  std::optional<Measured> measured;
};

// Reads what every check needs. `measured`: of the same core, if there was a measurement.
Subject read_subject(const HostFiles& files, int cpu, std::optional<Measured> measured = std::nullopt);

// A check uses nothing but its Subject. Its answer is `unknown` when the deciding file cannot be read, never `ok` when
// the file is absent, and `not_applicable` only when a file says so.
struct Item {
  int number = 0;  // in docs/host.md
  const char* id = "";
  const char* title = "";
  // In both, {cpu} is the core, {others} are all other cores, and {others_mask} the same as a mask.
  const char* why = "";
  const char* fix = "";
  bool reboot = false;  // the fix is in force after a new boot only
  Finding (*check)(const Subject& subject) = nullptr;
};

// All items, by number.
std::span<const Item> checklist();

// `why` and `fix` of an item, for this core.
std::string for_core(const char* text, const Subject& subject);

}  // namespace lithe::host
