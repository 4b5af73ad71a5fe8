// SPDX-License-Identifier: Apache-2.0
// Threads on selected cores, and the kernel's counts about the calling thread.
#pragma once

#include <cstdint>
#include <functional>
#include <thread>

namespace lithe::bench {

// The two cores a bench uses: where the Spine would tick, and its partner (Transport or Brain).
struct Cores {
  int spine = 0;
  int partner = 0;
};

// LITHE_BENCH_CORES=spine,partner; otherwise those that `lithe run` would use. Ends the program with a message when
// this process cannot use two cores.
Cores pick_cores();

// Starts a thread already pinned to `cpu`.
std::thread on_core(int cpu, std::function<void()> body);

// Pins the calling thread; ends the program when that is refused.
void pin_or_exit(int cpu);

// Picks the cores and makes the calling thread like a Spine's: on its core, with its priority and its memory locked.
// The last two are not required: where they are refused, the figures are those of this machine as it is.
Cores become_a_spine();

// The kernel's counts about the calling thread since its start.
struct ThreadToll {
  std::int64_t wall_ns = 0;
  std::int64_t cpu_ns = 0;
  std::int64_t involuntary_switches = 0;
  std::int64_t voluntary_switches = 0;
  std::int64_t minor_faults = 0;
};
ThreadToll thread_toll();

}  // namespace lithe::bench
