// SPDX-License-Identifier: Apache-2.0
// What `lithe tune` changes, as data: it is printed (plan), written (apply) and undone (revert) from the same list.
#pragma once

#include <cstdint>
#include <string>

namespace lithe::host {

enum class ChangeKind : std::uint8_t {
  file,      // the whole text of an ordinary file, replaced at once: a boot file, limits.d, a systemd unit, a udev rule
  setting,   // one value written to a file of the kernel: /proc/sys, /sys
  affinity,  // the cores of a task: path is /proc/PID/task/TID, values are cpu lists ("0,2-3")
};

struct Change {
  ChangeKind kind = ChangeKind::setting;
  std::string item;         // of the checklist: "irq_affinity"
  std::string path;         // without the root
  bool was_absent = false;  // kind file: there was no file; revert removes it
  std::string before;       // the value or text that was read
  std::string after;        // the value or text to write
  std::string why;          // one sentence
  bool reboot = false;      // in force only after a new boot
};

}  // namespace lithe::host
