// SPDX-License-Identifier: Apache-2.0
// Kernel settings, until the next boot, that keep other work off the robot's cores.
#pragma once

#include <vector>

#include "host/read/files.hpp"
#include "host/tune/change.hpp"

namespace lithe::host {

// The settings that differ: interrupts, workqueues, watchdogs, timers, memory scanning, frequency. `cores`: the
// robot's, ascending. A setting that this kernel does not have is left out; one that cannot be read is `not_done`, with
// the reason. Only reads.
Plan runtime_plan(const HostFiles& files, const std::vector<int>& cores);

}  // namespace lithe::host
