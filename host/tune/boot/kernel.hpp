// SPDX-License-Identifier: Apache-2.0
// The options of the kernel that will boot, and the boot flags for it: only flags that it knows. Off the tick.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "host/read/files.hpp"
#include "host/tune/boot/boot.hpp"
#include "host/tune/boot/line.hpp"

namespace lithe::host {

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
