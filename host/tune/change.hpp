// SPDX-License-Identifier: Apache-2.0
// What `lithe tune` changes, as data: it is printed (plan), written (apply) and undone (revert) from the same list.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace lithe::host {

enum class ChangeKind : std::uint8_t {
  file,      // the whole text of an ordinary file, replaced at once: a boot file, limits.d, a systemd unit, a udev rule
  setting,   // one value written to a file of the kernel: /proc/sys, /sys
  affinity,  // the cores of a task: path is /proc/PID/task/TID, values are cpu lists ("0,2-3")
  folder,    // a folder that is made: a group of tasks. `was_absent` is true; the values are empty
  group,     // the same, a group of threads of cgroup v2 (cgroup.type is "threaded")
  controller,  // one word of a cgroup.subtree_control: `was_absent` is true, `after` is the controller
};

// As in journals and in JSON.
inline constexpr const char* kChangeKinds[] = {"file", "setting", "affinity", "folder", "group", "controller"};

struct Change {
  ChangeKind kind = ChangeKind::setting;
  std::string item{};                  // of the checklist: "irq_affinity"
  std::string path{};                  // without the root
  bool was_absent = false;             // kinds file and folder: there was none; revert removes it
  std::string before{};                // the value or text that was read
  std::string after{};                 // the value or text to write
  std::string why{};                   // one sentence
  bool reboot = false;                 // in force only after a new boot
  std::uint64_t start_time_ticks = 0;  // kind affinity: tells the task from a later one with the same number
};

// What could not be planned or done: the file, and why.
struct NotDone {
  std::string item, path, why;
};

struct Plan {
  std::vector<Change> changes;
  std::vector<NotDone> not_done;
  std::vector<std::string> notes;  // what a person should know beside it
};

}  // namespace lithe::host
