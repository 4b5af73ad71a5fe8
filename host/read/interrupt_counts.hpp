// SPDX-License-Identifier: Apache-2.0
// How often a core was interrupted since the boot, by cause: x86 and ARM name the rows differently. Off the tick.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "host/read/files.hpp"
#include "spine/core/result.hpp"

namespace lithe::host {

struct DeviceCount {
  int number = 0;  // as in /proc/irq
  std::string name;
  std::uint64_t count = 0;
};

// Nothing where /proc/interrupts has no such row.
struct CoreInterrupts {
  std::optional<std::uint64_t> timer;  // LOC; ARM: arch_timer
  std::optional<std::uint64_t> cores;  // from other cores: RES, CAL, TLB; ARM: IPI0, IPI1, ...
  std::vector<DeviceCount> devices;

  std::uint64_t device_total() const;
};

// The error names the file.
Result<CoreInterrupts> count_interrupts(const HostFiles& files, int cpu);

}  // namespace lithe::host
