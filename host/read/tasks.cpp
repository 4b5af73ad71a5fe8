// SPDX-License-Identifier: Apache-2.0
#include "host/read/tasks.hpp"

#include <algorithm>
#include <optional>
#include <sstream>

#include "host/read/words.hpp"
#include "spine/core/host/cores.hpp"
#include "spine/core/lookup.hpp"

namespace lithe::host {
namespace {

constexpr unsigned long kKernelThread = 0x00200000;  // PF_KTHREAD
constexpr unsigned long kBound = 0x04000000;         // PF_NO_SETAFFINITY
// Fields of /proc/PID/stat behind the name: flags is field 9, start time 22, policy 41 (man 5 proc_pid_stat).
constexpr std::size_t kFlags = 9 - 3, kStartTime = 22 - 3, kPolicy = 41 - 3;

// "12 (a name) S 1 ...": the name may contain any character.
std::optional<Task> parse_task(const std::string& stat, const std::string& status) {
  const std::size_t open = stat.find('('), close = stat.rfind(')');
  if (open == std::string::npos || close == std::string::npos || close < open) return std::nullopt;
  std::vector<std::string> fields;
  std::istringstream rest(stat.substr(close + 1));
  for (std::string word; rest >> word;) fields.push_back(word);
  const std::string cpus = field_of(status, "Cpus_allowed_list");
  if (fields.size() <= kPolicy || cpus.empty()) return std::nullopt;
  const std::optional<long long> flags = whole_number(fields[kFlags]), policy = whole_number(fields[kPolicy]);
  const std::optional<long long> start = whole_number(fields[kStartTime]);
  if (!flags || !policy || !start) return std::nullopt;
  Task task;
  task.name = stat.substr(open + 1, close - open - 1);
  task.is_kernel = (static_cast<unsigned long>(*flags) & kKernelThread) != 0;
  task.is_bound = (static_cast<unsigned long>(*flags) & kBound) != 0;
  task.policy = static_cast<int>(*policy);
  task.start_time_ticks = static_cast<std::uint64_t>(*start);
  task.cpus = parse_cpu_list(cpus);
  return task;
}

void read_process(const HostFiles& files, const std::string& pid, Tasks& tasks) {
  const std::string folder = "/proc/" + pid + "/task";
  const std::vector<std::string> threads = files.list(folder);
  if (threads.empty() && !files.is_gone(folder)) tasks.why_not_whole = folder + " cannot be listed";
  for (const std::string& tid : threads) {
    const std::string each = folder + "/" + tid;
    if (std::optional<Task> task = read_task(files, each))
      tasks.all.push_back(std::move(*task));
    else if (!files.is_gone(each))  // else it has ended meanwhile
      tasks.why_not_whole = each + " cannot be read";
  }
}

}  // namespace

bool Task::may_run_on(int cpu) const { return std::ranges::binary_search(cpus, cpu); }

std::optional<Task> read_task(const HostFiles& files, const std::string& path) {
  const std::string pid = path.substr(6, path.find('/', 6) - 6), tid = path.substr(path.rfind('/') + 1);  // "/proc/"
  const Reading stat = files.read(path + "/stat"), status = files.read(path + "/status");
  const std::optional<int> process = whole_number<int>(pid), thread = whole_number<int>(tid);
  if (!process || !thread || !stat.known() || !status.known()) return std::nullopt;
  std::optional<Task> task = parse_task(stat.value, status.value);
  if (!task) return std::nullopt;
  task->pid = *process;
  task->tid = *thread;
  return task;
}

Tasks read_tasks(const HostFiles& files, const std::vector<int>& pids) {
  Tasks tasks;
  for (const int pid : pids) read_process(files, std::to_string(pid), tasks);
  if (!pids.empty()) {
    tasks.why_not_whole = "only some processes were read";
    return tasks;
  }
  for (const std::string& pid : files.list("/proc"))
    if (whole_number<unsigned>(pid)) read_process(files, pid, tasks);
  const auto named = [&](int pid, const char* name) {
    return std::ranges::any_of(
        tasks.all, [&](const Task& each) { return each.pid == pid && (*name == '\0' || each.name == name); });
  };
  // Only the first process id namespace has the kernel's own threads; hidepid hides them as it hides process 1.
  if (tasks.is_whole() && (!named(2, "kthreadd") || !named(1, "")))
    tasks.why_not_whole = "/proc shows a part of the machine's tasks only (a container, or hidepid)";
  return tasks;
}

}  // namespace lithe::host
