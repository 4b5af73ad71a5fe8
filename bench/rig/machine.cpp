// SPDX-License-Identifier: Apache-2.0
#include "bench/rig/machine.hpp"

#include <sys/resource.h>
#include <time.h>

#include <cstdio>
#include <cstdlib>
#include <utility>

#include "spine/core/host/paths.hpp"
#include "spine/core/host/realtime.hpp"
#include "spine/core/time.hpp"
#include "spine/robot/cores/cpu_plan.hpp"

namespace lithe::bench {

void give_up(const std::string& why) {
  std::fprintf(stderr, "bench: %s\n", why.c_str());
  std::exit(2);
}

Cores pick_cores() {
  const MachineCores machine = machine_cores();
  if (const std::size_t cores = machine.automatic().size(); cores < 2)
    give_up("needs two cores, this process may use " + std::to_string(cores));
  Cores wanted;
  if (const std::string named = environment("LITHE_BENCH_CORES"); !named.empty()) {
    if (std::sscanf(named.c_str(), "%d,%d", &wanted.spine, &wanted.partner) == 2 && wanted.spine != wanted.partner)
      return wanted;
    give_up("LITHE_BENCH_CORES names two different cores, as in 1,3; it says '" + named + "'");
  }
  const robot::CpuPlan plan = robot::fold_cpus(machine);
  return {plan.spine, plan.transport_inline ? plan.housekeeping : plan.transport};
}

void pin_or_exit(int cpu) { or_exit(pin_this_thread(cpu)); }

Cores become_a_spine() {
  const Cores cores = pick_cores();
  pin_or_exit(cores.spine);
  raise_priority();
  if (const auto locked = lock_memory(); !locked) std::fprintf(stderr, "bench: %s\n", locked.message().c_str());
  return cores;
}

std::thread on_core(int cpu, std::function<void()> body) {
  return std::thread([cpu, body = std::move(body)] {
    pin_or_exit(cpu);
    body();
  });
}

Competitor::Competitor(int cpu, void (*first)())
    : thread_(on_core(cpu, [this, first] {
        first();
        while (!stop_.load(std::memory_order_relaxed)) spin_pause();
      })) {}

Competitor::~Competitor() {
  stop_.store(true, std::memory_order_relaxed);  // pairs with the load in its loop
  thread_.join();
}

ThreadToll thread_toll() {
  rusage usage{};
  getrusage(RUSAGE_THREAD, &usage);
  timespec cpu{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &cpu);
  return {monotonic_ns(), cpu.tv_sec * kNsPerS + cpu.tv_nsec, usage.ru_nivcsw, usage.ru_nvcsw, usage.ru_minflt};
}

}  // namespace lithe::bench
