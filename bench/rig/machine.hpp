// SPDX-License-Identifier: Apache-2.0
// Threads on selected cores, the kernel's counts about the calling thread, and the end of a bench that cannot go on.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <string>
#include <thread>
#include <utility>

#include "spine/core/result.hpp"

namespace lithe::bench {

[[noreturn]] void give_up(const std::string& why);

template <class T>
T or_exit(Result<T> result) {
  if (!result) give_up(result.message());
  return std::move(*result);
}

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

// A thread that uses a core as much as it can, after `first()`.
class Competitor {
 public:
  explicit Competitor(int cpu, void (*first)() = [] {});
  ~Competitor();
  Competitor(const Competitor&) = delete;
  Competitor& operator=(const Competitor&) = delete;

 private:
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

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

// Wall time, and the processor time that a thread had in it.
struct Had {
  double wall_ns = 0, cpu_ns = 0;

  void add(const ThreadToll& before, const ThreadToll& after) {
    wall_ns += static_cast<double>(after.wall_ns - before.wall_ns);
    cpu_ns += static_cast<double>(after.cpu_ns - before.cpu_ns);
  }
  double share() const { return wall_ns > 0 ? cpu_ns / wall_ns : 0; }
};

}  // namespace lithe::bench
