// SPDX-License-Identifier: Apache-2.0
#include "host/tune/shield/tasks.hpp"

#include <cstddef>
#include <cstdlib>
#include <sstream>

#include "spine/core/host/cores.hpp"

namespace lithe::host {
namespace {

constexpr std::uint64_t kNoSetAffinity = 0x04000000;  // PF_NO_SETAFFINITY of the kernel
constexpr int kFlags = 6, kStartTime = 19;            // proc(5): fields of stat, counted from the state

// "Cpus_allowed_list:\t0-1"
std::vector<int> allowed_in(const std::string& status) {
  const std::string key = "\nCpus_allowed_list:";
  const std::size_t at = status.find(key);
  if (at == std::string::npos) return {};
  const std::size_t from = status.find_first_not_of(" \t", at + key.size());
  return from == std::string::npos ? std::vector<int>{} : parse_cpu_list(status.substr(from));
}

bool is_pid(const std::string& name) {
  return !name.empty() && name.size() < 10 && name.find_first_not_of("0123456789") == std::string::npos;
}

}  // namespace

std::optional<MovableTask> read_task(const HostFiles& files, const std::string& path) {
  MovableTask task;
  std::istringstream numbers(path.substr(std::string("/proc/").size()));
  std::string word;
  numbers >> task.pid;
  task.tid = std::atoi(path.substr(path.rfind('/') + 1).c_str());
  const std::string stat = files.read(path + "/stat").value;
  const std::size_t open = stat.find('('), close = stat.rfind(") ");  // the name may hold anything
  if (open == std::string::npos || close == std::string::npos || task.tid <= 0) return std::nullopt;
  task.name = stat.substr(open + 1, close - open - 1);
  std::istringstream fields(stat.substr(close + 2));
  for (int i = 0; i <= kStartTime && fields >> word; ++i) {
    if (i == kFlags) task.bound = (std::strtoull(word.c_str(), nullptr, 10) & kNoSetAffinity) != 0;
    if (i == kStartTime) task.start_time_ticks = std::strtoull(word.c_str(), nullptr, 10);
  }
  task.cores = allowed_in(files.read(path + "/status").value);
  if (task.cores.empty()) return std::nullopt;
  return task;
}

std::vector<MovableTask> all_tasks(const HostFiles& files, const std::vector<int>& pids) {
  std::vector<std::string> processes;
  for (const int pid : pids) processes.push_back(std::to_string(pid));
  if (pids.empty()) processes = files.list("/proc");
  std::vector<MovableTask> tasks;
  for (const std::string& pid : processes) {
    if (!is_pid(pid)) continue;
    for (const std::string& tid : files.list("/proc/" + pid + "/task")) {
      if (auto task = read_task(files, "/proc/" + pid + "/task/" + tid)) tasks.push_back(std::move(*task));
    }
  }
  return tasks;
}

}  // namespace lithe::host
