// SPDX-License-Identifier: Apache-2.0
// The tasks of a machine, those of the kernel among them, and the cores that each may run on.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "host/read/files.hpp"

namespace lithe::host {

struct MovableTask {
  int pid = 0;
  int tid = 0;
  std::string name{};
  std::uint64_t start_time_ticks = 0;  // since boot; with the tid it names this task and no later one
  std::vector<int> cores{};            // ascending
  bool bound = false;                  // the kernel lets nobody move it

  std::string path() const { return "/proc/" + std::to_string(pid) + "/task/" + std::to_string(tid); }
};

// `path`: /proc/PID/task/TID. Empty when there is no such task (any more).
std::optional<MovableTask> read_task(const HostFiles& files, const std::string& path);

// All that run, or those of `pids`; a task that ends meanwhile is left out.
std::vector<MovableTask> all_tasks(const HostFiles& files, const std::vector<int>& pids = {});

}  // namespace lithe::host
