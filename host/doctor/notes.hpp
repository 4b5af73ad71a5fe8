// SPDX-License-Identifier: Apache-2.0
// Collects the evidence of one check.
#pragma once

#include <initializer_list>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "host/doctor/item.hpp"

namespace lithe::host {

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
  void add(const std::string& path, const std::string& value);

  // Reads a whole number; nothing if it is unread or none.
  std::optional<long long> number(const std::string& path);

  Finding say(State state, std::string words) const { return {state, std::move(words), evidence_}; }

  // `unknown`, for a file that decides and cannot be read: "PATH cannot be read (Permission denied)".
  Finding unread(const std::string& path) const;

 private:
  const HostFiles& files_;
  std::vector<Evidence> evidence_;
};

// "3 threads (kworker/u4:1, rcu_preempt, ...)".
std::string some_of(const std::vector<std::string>& names, const char* noun);

// Whether a feature is not in this kernel: its folder is absent, and the folder above it is there.
bool has_no(const Subject& subject, const std::string& parent, const std::string& name);

}  // namespace lithe::host
