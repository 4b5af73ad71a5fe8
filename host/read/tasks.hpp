// SPDX-License-Identifier: Apache-2.0
// Every task of the machine, with the cores it may run on. Off the tick.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "host/read/files.hpp"

namespace lithe::host {

struct Task {
  int pid = 0;  // of its process
  int tid = 0;
  std::string name;                    // as the kernel has it: at most 15 characters
  bool is_kernel = false;              // a thread of the kernel
  bool is_bound = false;               // the kernel lets nobody move it (a worker of one core)
  int policy = 0;                      // as in <sched.h>: 1 SCHED_FIFO, 2 SCHED_RR
  std::vector<int> cpus;               // it may run on, ascending
  std::uint64_t start_time_ticks = 0;  // since boot; with the tid it names this task and no later one

  std::string path() const { return "/proc/" + std::to_string(pid) + "/task/" + std::to_string(tid); }
  bool may_run_on(int cpu) const;
  bool is_realtime() const { return policy == 1 || policy == 2; }
  bool is_spine() const { return name.starts_with("lithe-spine"); }
};

// What /proc shows. It is not whole when a task could not be read, and when this process sees only a part of the
// machine (a container, /proc with hidepid): then "there is no such task" is not known.
struct Tasks {
  std::vector<Task> all;
  std::string why_not_whole;  // empty: it is whole

  bool is_whole() const { return why_not_whole.empty(); }
};

// `path`: /proc/PID/task/TID. Empty when there is no such task (any more), or when it cannot be read.
std::optional<Task> read_task(const HostFiles& files, const std::string& path);

// All of them, or those of the processes `pids`; these alone are never whole.
Tasks read_tasks(const HostFiles& files, const std::vector<int>& pids = {});

}  // namespace lithe::host
