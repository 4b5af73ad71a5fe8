// SPDX-License-Identifier: Apache-2.0
// Set-up of a real-time thread: core, priority, locked memory.
#pragma once

#include <sys/types.h>

#include <cstddef>
#include <vector>

#include "spine/core/result.hpp"

namespace lithe {

// The affinity of a thread (0: the calling one): the cores it may run on now, ascending; empty if unknown.
std::vector<int> allowed_cpus(pid_t thread = 0);

// Lets a thread (0: the calling one) run on these cores alone; 0 or errno. May be called between fork and exec.
int set_allowed_cpus(pid_t thread, const std::vector<int>& cores);

// Pins the calling thread; it joins the group of a shield (shield_group.hpp) for a core that only its members have, and
// leaves it for another core. The error names the core and those allowed.
Result<> pin_this_thread(int cpu);

// Asks for nice -20 for the calling thread; returns the nice value now in force.
int raise_priority();

// Back to nice 0: a thread inherits its starter's, and a helper must not delay the tick.
void ordinary_priority();

// Threads started from now on get 512 KiB of stack instead of 8 MiB: locked memory counts whole stacks.
void use_small_stacks();

// Locks all present and future memory, so that the tick never faults. Refused when the limit would leave less than
// 16 MiB for what is still to come: a later thread or mapping would fail.
Result<> lock_memory();

// Touches that much of the calling thread's stack: without the right to lock memory, the next best thing.
void touch_stack(std::size_t bytes = 256 * 1024);

// Keeps malloc from growing or shrinking the address space while the tick runs (no trimming, no mmap, one arena).
void freeze_malloc();

}  // namespace lithe
