// SPDX-License-Identifier: Apache-2.0
// `lithe tune`: the whole plan of a machine or of a mounted image, made and undone.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "host/tune/journal/journal.hpp"
#include "host/tune/lasting.hpp"
#include "spine/robot/config.hpp"

namespace lithe::host {

// Journal of settings that end with a boot; /run is empty after it.
inline constexpr const char* kRunJournal = "/run/lithe/tune.journal";
// Journal of files, which survive a boot.
inline constexpr const char* kLastingJournal = "/var/lib/lithe/tune.journal";

struct Target {
  std::string root{};                         // "": this machine
  bool image = false;                         // a mounted image: only its files are planned
  std::vector<int> all_cores{};               // all cores of the machine, ascending
  std::vector<int> cores{};                   // those of the robot, ascending
  int spine = -1;                             // of these, the Spine's: it loses the tick; -1: the first
  bool partition = false;                     // make an isolated partition of cgroup v2, until the next boot
  bool files = true;                          // change files that outlive a boot, too
  std::string program{};                      // lithe itself, for the unit of systemd; empty: no unit
  std::optional<robot::RobotConfig> robot{};  // whose devices keep their names
};

struct TunePlan : Plan {
  std::string board{};                  // "" when no boot file of a known board was found
  std::vector<std::string> commands{};  // to run afterwards; shown, never run
};

struct TuneResult {
  std::vector<Step> steps{};
  std::vector<std::string> notes{};
  std::vector<std::string> commands{};  // of revert: to run afterwards
  bool no_partition = false;            // it was planned, and the kernel made none; a note says why
  bool incomplete = false;      // a journal cannot be opened, or has lines that cannot be undone; a note says it
  bool still_shielded = false;  // a killed robot's shield could not be lowered in full

  void refuse(const Error& why);
  bool well() const;  // every step succeeded, and no shield is left
};

// Only reads.
TunePlan tune_plan(const Target& target);

// Makes the changes. Errors: a journal cannot be opened (no permission, or another process tunes).
Result<TuneResult> tune_apply(const Target& target, const std::vector<Change>& changes, const StepHook& hook = {});

// Undoes each change of tune_apply() whose value nobody has changed since, and lowers the shield that a killed robot
// left. `target.cores` is not used.
Result<TuneResult> tune_revert(const Target& target, bool forget, const StepHook& hook = {});

}  // namespace lithe::host
