// SPDX-License-Identifier: Apache-2.0
// The kernel's command line that isolates cores from boot on, as a change to this board's boot file. Off the tick.
//
// Known boot files: Raspberry Pi OS (cmdline.txt), Jetson Linux (extlinux.conf), GRUB of Debian and Ubuntu
// (/etc/default/grub and /etc/debian_version are there), systemd-boot (/etc/kernel/cmdline). docs/boards.md says more.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "host/read/files.hpp"
#include "host/tune/boot/edit.hpp"
#include "host/tune/change.hpp"
#include "spine/core/result.hpp"

namespace lithe::host {

inline constexpr const char* kBootItem = "boot_line";

struct BootPlan {
  std::string board;                  // name of its file in host/boards, without ".toml": "pi5"
  std::vector<Change> changes;        // one file, or none: the boot file has all flags already
  std::vector<std::string> commands;  // for a shell, as root, afterwards: "update-grub"; of an image with chroot
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

// What to run once a change of the boot file was taken back, whatever else stands in it now.
std::vector<std::string> boot_commands(const HostFiles& files);

// The options of the kernel that will boot, and the boot flags for it: only flags that it knows. Off the tick.

// Facts about the running kernel. Below a root without /proc: about all kernels installed there, because any may boot.
struct Kernel {
  int version = 0;                     // 5006 is 5.6; of several the oldest; 0: not known
  std::vector<std::string> configs;    // how each was built; empty: not known
  bool steady_tsc = false;             // x86: /proc/cpuinfo has constant_tsc and nonstop_tsc
  std::vector<std::string> not_known;  // sentences: what could not be read, and what to do

  bool has(std::string_view option) const;    // "NO_HZ_FULL": each has CONFIG_NO_HZ_FULL=y
  bool lacks(std::string_view option) const;  // one says "# CONFIG_NO_HZ_FULL is not set"
};

Kernel read_kernel(const HostFiles& files);

struct KernelFlags {
  std::vector<Flag> flags;
  std::vector<std::string> notes;  // what was left out, and why
};

// An error when the kernel cannot isolate cores at boot.
Result<KernelFlags> flags_for(const Kernel& kernel, const BootCores& cores);

}  // namespace lithe::host
