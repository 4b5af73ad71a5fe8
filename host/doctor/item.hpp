// SPDX-License-Identifier: Apache-2.0
// The checklist of `lithe doctor` as one table. A check reads, judges, and names what it has read.
#pragma once

#include <fmt/format.h>

#include <cstdint>
#include <initializer_list>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "host/doctor/measure/measure.hpp"
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

inline constexpr const char* kCommandLine = "/proc/cmdline";
inline constexpr const char* kAllTasks = "/proc/*/task/*/status";  // as evidence: all tasks were read

// "(absent)", "(Permission denied)", or the value, shortened.
std::string shown(const Reading& reading);

// The worst of several states, in the order fail, warn, unknown, ok, not_applicable. Parts of one item must not mix
// `fail` and `warn`: a file that disappears could then turn one into the other.
State worst(std::initializer_list<State> parts);

class Notes {
 public:
  explicit Notes(const Subject& subject) : files_(subject.files) {}

  // Reads and keeps it as evidence.
  Reading read(const std::string& path);
  void add(const std::string& path, const std::string& value) { evidence_.push_back({path, value}); }
  template <class... Args>
  void add(const std::string& path, fmt::format_string<Args...> value, Args&&... args) {
    add(path, fmt::format(value, std::forward<Args>(args)...));
  }

  // Reads a whole number; nothing if it is unread or none.
  std::optional<long long> number(const std::string& path);

  Finding say(State state, std::string words) const { return {state, std::move(words), evidence_}; }
  template <class... Args>
  Finding say(State state, fmt::format_string<Args...> words, Args&&... args) const {
    return say(state, fmt::format(words, std::forward<Args>(args)...));
  }

  // `unknown`, for a file that decides and cannot be read: "PATH cannot be read (Permission denied)".
  Finding unread(const std::string& path) const;

  // `unknown`, for a judgement that needs all tasks, where not all can be seen.
  Finding not_whole(const Tasks& tasks);

 private:
  const HostFiles& files_;
  std::vector<Evidence> evidence_;
};

// "3 threads (kworker/u4:1, rcu_preempt, ...)".
std::string some_of(const std::vector<std::string>& names, const char* noun);

// Whether a feature is not in this kernel: its folder is absent, and the folder above it is there.
bool has_no(const Subject& subject, const std::string& parent, const std::string& name);

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
  Finding (*judge)(const Subject& subject, Notes& notes) = nullptr;

  Finding check(const Subject& subject) const {
    Notes notes(subject);
    return judge(subject, notes);
  }
};

// All items, by number.
std::span<const Item> checklist();

// `why` and `fix` of an item, for this core.
std::string for_core(const char* text, const Subject& subject);

// The items of the checklist, each with its check: one function a file, in the order of their numbers.
inline constexpr bool kReboot = true, kNow = false;  // when the fix of an item is in force

std::span<const Item> scheduler_items();
std::span<const Item> realtime_items();
std::span<const Item> interrupts_items();
std::span<const Item> kernel_noise_items();
std::span<const Item> power_items();
std::span<const Item> memory_items();

}  // namespace lithe::host
