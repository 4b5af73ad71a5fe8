// SPDX-License-Identifier: Apache-2.0
// The kernel's command line that isolates cores from boot on, as a change to this board's boot file. Off the tick.
//
// Known boot files: Raspberry Pi OS (cmdline.txt), Jetson Linux (extlinux.conf), GRUB of Debian and Ubuntu
// (/etc/default/grub and /etc/debian_version are there), systemd-boot (/etc/kernel/cmdline). docs/boards.md says more.
#pragma once

#include <string>
#include <vector>

#include "host/read/files.hpp"
#include "host/tune/change.hpp"
#include "spine/core/result.hpp"

namespace lithe::host {

struct BootPlan {
  std::string board;                  // name of its file in host/boards, without ".toml": "pi5"
  std::vector<Change> changes;        // one file, or none: the boot file has all flags already
  std::vector<std::string> commands;  // for a shell, as root, after the changes and after their reversal: "update-grub"
  std::vector<std::string> notes;     // sentences for the user
};

// Cores have the kernel's numbers.
struct BootCores {
  std::vector<int> isolated;  // taken from the scheduler: not empty, without `housekeeping`
  std::vector<int> tickless;  // of these, without a tick where the kernel can do that (the Spine's); may be empty
  int housekeeping = 0;       // gets the interrupts of devices
};

// Reads, writes nothing. An error when the board or its boot file is not known (with the line to add by hand), when
// the boot file is not as a boot file must be, or when it has one of our flags with another value.
Result<BootPlan> boot_plan(const HostFiles& files, const BootCores& cores);

}  // namespace lithe::host
