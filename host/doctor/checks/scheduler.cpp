// SPDX-License-Identifier: Apache-2.0
// Items 1 to 7: who else may run on the core.
#include <fmt/format.h>
#include <unistd.h>

#include <set>

#include "host/doctor/item.hpp"
#include "host/read/machine.hpp"
#include "host/read/words.hpp"
#include "spine/core/lookup.hpp"

namespace lithe::host {
namespace {

constexpr const char* kIsolated = "/sys/devices/system/cpu/isolated";
constexpr const char* kOwnGroup = "/proc/self/cgroup";
constexpr const char* kSchedStat = "/proc/schedstat";
constexpr const char* kV1 = "/sys/fs/cgroup/cpuset";
constexpr const char* kV1Balance = "/sys/fs/cgroup/cpuset/cpuset.sched_load_balance";
constexpr double kBoundSwitchesPerS = 2;  // what only the core's own kernel threads cause

// Which cores the scheduler balances over, as its statistics list them.
struct Domains {
  bool listed = false;  // this core is in the list
  bool here = false;    // it has a domain
  bool others = false;  // another core has one

  // The last core that is not isolated has no domain either: there is none to balance with.
  bool isolate() const { return listed && !here && others; }
};

Domains read_domains(const Subject& subject, const std::string& text) {
  Domains domains;
  bool here = false;
  for (const std::string_view line : lines_in(text)) {
    if (line.starts_with("cpu")) here = line.starts_with(fmt::format("cpu{} ", subject.cpu));
    domains.listed = domains.listed || here;
    if (line.starts_with("domain")) (here ? domains.here : domains.others) = true;
  }
  return domains;
}

// Whether cgroup v1 has taken the core out of the balancing: the root balances nothing, and no group with the core
// does. One whose cores cannot be read may have it.
bool is_out_of_v1(const Subject& subject, Notes& notes) {
  if (subject.files.read(kV1Balance).value != "0") return false;
  notes.read(kV1Balance);
  for (const std::string& group : subject.files.list(kV1)) {
    const std::string folder = fmt::format("{}/{}", kV1, group);
    const Reading cpus = subject.files.read(folder + "/cpuset.cpus");
    if (cpus.is_absent() || subject.files.read(folder + "/cpuset.sched_load_balance").value == "0") continue;
    if (!cpus.known() || contains(parse_cpu_list(cpus.value), subject.cpu)) return false;
  }
  return true;
}

// Words about an option isolcpus that names this core and is not in force; empty if there is none.
std::string dropped_option(const Subject& subject, Notes& notes) {
  for (const std::string& option : split(subject.files.read(kCommandLine).value)) {
    if (!option.starts_with("isolcpus=")) continue;
    notes.add(kCommandLine, option);
    std::string cpus = option.substr(option.find('=') + 1);
    while (!cpus.empty() && (cpus[0] < '0' || cpus[0] > '9')) {
      const std::size_t comma = cpus.find(',');
      cpus.erase(0, comma == std::string::npos ? comma : comma + 1);
    }
    if (!contains(parse_cpu_list(cpus), subject.cpu)) return fmt::format("; {} does not name it", option);
    if (option.find("nohz") == std::string::npos) return fmt::format("; the kernel did not take {}", option);
    return fmt::format("; a kernel without CONFIG_NO_HZ_FULL drops all of {} because of its flag nohz", option);
  }
  return "";
}

// Threads that are not ours, that somebody could move away, and that may run on the core.
std::vector<std::string> movable(const Subject& subject, bool kernel, Notes& notes) {
  std::vector<std::string> names;
  for (const Task& each : subject.tasks.all) {
    const bool ours = each.is_spine() || (subject.files.root().empty() && each.pid == ::getpid());
    if (ours || each.is_kernel != kernel || each.is_bound || !each.may_run_on(subject.cpu)) continue;
    if (names.empty()) {
      notes.add(fmt::format("/proc/{}/task/{}/status", each.pid, each.tid), "{}: Cpus_allowed_list {}", each.name,
                cpu_list(each.cpus));
    }
    names.push_back(fmt::format("{} {}", each.tid, each.name));
  }
  return names;
}

Finding judge_movable(const Subject& subject, bool kernel, State when_some, Notes& notes) {
  const std::vector<std::string> names = movable(subject, kernel, notes);
  const char* noun = kernel ? "movable kernel thread" : "user thread";
  if (!names.empty()) return notes.say(when_some, "{} may run on core {}", some_of(names, noun), subject.cpu);
  if (!subject.tasks.is_whole()) return notes.not_whole(subject.tasks);
  notes.add(kAllTasks, "{} threads, none of these on core {}", subject.tasks.all.size(), subject.cpu);
  return notes.say(State::ok, "no {} may run on core {}", noun, subject.cpu);
}

// Whether cpusets belong to cgroup v1 here. Nothing when that cannot be read.
std::optional<bool> is_v1(Notes& notes) {
  const Reading groups = notes.read(kOwnGroup);
  if (groups.value.empty()) return std::nullopt;
  return groups.value.find(":cpuset:") != std::string::npos;
}

Finding check_domain_isolation(const Subject& subject, Notes& notes) {
  const int cpu = subject.cpu;
  const Reading boot = notes.read(kIsolated);
  const Isolation how = subject.isolated.how(cpu);
  if (how == Isolation::boot) return notes.say(State::ok, "core {} is isolated since the boot", cpu);
  if (how == Isolation::cpuset) {
    notes.read(kOwnGroup);
    return notes.say(State::ok, "core {} is in the isolated partition that this process is in or may join", cpu);
  }
  bool all_read = boot.known();
  // The cores that nothing takes from the tasks outside of it: no isolation, and no other partition.
  std::set<int> left(subject.online.begin(), subject.online.end());
  for (const int each : subject.isolated.all()) left.erase(each);
  for (const Partition& each : read_partitions(subject.files)) {
    all_read = all_read && each.kind.known() && each.wanted.known();
    const bool holds_it = contains(each.cpus, cpu);
    if (!each.is_isolated() && (each.kind.value != "root" || holds_it)) continue;
    for (const int its : each.cpus) left.erase(its);
    if (!holds_it) continue;
    notes.add(each.kind.path, each.kind.value);
    return notes.say(State::ok, "core {} is in an isolated partition", cpu);
  }
  const Domains domains = read_domains(subject, notes.read(kSchedStat).value);
  const bool last = left.size() == 1;
  if (last && all_read && subject.online.size() > 1)
    return notes.say(State::fail, "core {} is the last one that is not isolated: all tasks run there", cpu);
  if (domains.isolate() && !last && subject.online.size() > 1)
    return notes.say(State::ok, "core {} is in no scheduling domain", cpu);
  if (!all_read) return notes.say(State::unknown, "not everything that tells isolated cores can be read");
  if (domains.listed && !domains.here && left.size() > 1) {
    if (is_out_of_v1(subject, notes)) return notes.say(State::ok, "no cpuset balances core {}", cpu);
    return notes.say(State::unknown, "no core has a scheduling domain: which of them are isolated is not known");
  }
  return notes.say(State::fail, fmt::format("core {} is not isolated", cpu) + dropped_option(subject, notes));
}

Finding check_isolated_partition(const Subject& subject, Notes& notes) {
  bool all_read = true;
  const Partition* good = nullptr;
  const std::vector<Partition> partitions = read_partitions(subject.files);
  for (const Partition& each : partitions) {
    all_read = all_read && each.kind.known() && each.wanted.known();
    if (each.kind.value.empty()) continue;
    notes.add(each.kind.path, each.kind.value);
    if (each.is_invalid() && contains(parse_cpu_list(each.wanted.value), subject.cpu))
      return notes.say(State::fail, "the partition is not in force: {}", each.kind.value);
    if (each.is_isolated() && contains(each.cpus, subject.cpu)) good = &each;
  }
  const std::optional<bool> v1 = is_v1(notes);
  if (!all_read || !v1) return notes.say(State::unknown, "the files of a partition cannot be read");
  if (good != nullptr) return notes.say(State::ok, "core {} is in an isolated partition", subject.cpu);
  if (*v1) return notes.say(State::not_applicable, "cpusets belong to cgroup v1 here");
  if (subject.isolated.how(subject.cpu) == Isolation::boot) {
    notes.read(kIsolated);
    return notes.say(State::not_applicable, "the core is isolated since the boot");
  }
  const std::string folder = cgroup2_folder(subject.files);
  if (folder.empty()) return notes.say(State::unknown, "cgroup v2 is not found below /sys/fs/cgroup");
  const std::string path = folder + "/cgroup.controllers";
  const Reading controllers = notes.read(path);
  if (!controllers.known()) return notes.unread(path);
  if (!has_word(controllers.value, "cpuset")) return notes.say(State::warn, "cgroup v2 has no cpuset here");
  return notes.say(State::warn, "no isolated partition has core {}", subject.cpu);
}

Finding check_v1_shield(const Subject& subject, Notes& notes) {
  const std::optional<bool> v1 = is_v1(notes);
  if (!v1) return notes.unread(kOwnGroup);
  if (!*v1) return notes.say(State::not_applicable, "cpusets belong to cgroup v2 here");
  if (subject.isolated.how(subject.cpu) == Isolation::boot) {
    notes.read(kIsolated);
    return notes.say(State::not_applicable, "the core is isolated since the boot");
  }
  const std::optional<long long> balance = notes.number(kV1Balance);
  if (!balance) return notes.unread(kV1Balance);
  if (*balance != 0) return notes.say(State::warn, "the root cpuset balances over all cores");
  std::vector<std::string> left = movable(subject, false, notes);
  for (std::string& each : movable(subject, true, notes)) left.push_back(std::move(each));
  if (!left.empty()) {
    return notes.say(State::fail, "balancing is off, and tasks were left behind, which is worse than no shield: " +
                                      some_of(left, "thread"));
  }
  if (!subject.tasks.is_whole()) return notes.say(State::unknown, subject.tasks.why_not_whole);
  return notes.say(State::ok, "balancing is off and no movable task is left on the core");
}

Finding check_user_tasks(const Subject& subject, Notes& notes) {
  return judge_movable(subject, false, State::fail, notes);
}

Finding check_kernel_threads(const Subject& subject, Notes& notes) {
  return judge_movable(subject, true, State::warn, notes);
}

Finding check_bound_kernel_threads(const Subject& subject, Notes& notes) {
  std::size_t bound = 0;
  for (const Task& each : subject.tasks.all) bound += each.is_bound && each.may_run_on(subject.cpu) ? 1 : 0;
  notes.add(kAllTasks, "{} kernel threads are bound to core {}", bound, subject.cpu);
  if (!subject.measured)
    return notes.say(State::unknown, "how often they run is not in a file: lithe doctor --measure 10 counts it");
  const double rate = subject.measured->switches_per_s;
  notes.add("--measure", "{:.1f} involuntary switches/s", rate);
  return notes.say(rate <= kBoundSwitchesPerS ? State::ok : State::warn,
                   "other tasks took the core {:.1f} times a second", rate);
}

Finding check_workqueues(const Subject& subject, Notes& notes) {
  const std::string path = "/sys/devices/virtual/workqueue/cpumask";
  const std::optional<std::vector<int>> cpus = parse_mask(notes.read(path).value);
  if (!cpus) return notes.unread(path);
  if (!contains(*cpus, subject.cpu)) return notes.say(State::ok, "unbound work of the kernel runs on other cores");
  return notes.say(State::warn, "unbound work of the kernel may run on core {}", subject.cpu);
}

constexpr Item kSchedulerItems[] = {
    {1, "domain_isolation", "The core is taken from the scheduler",
     "the kernel then moves no task to it: everything else on the machine stays off the Spine's core",
     "at run time: an isolated cpuset partition with core {cpu}; at boot: isolcpus=managed_irq,domain,{cpu} (no nohz "
     "in it unless the kernel has CONFIG_NO_HZ_FULL)",
     kNow, check_domain_isolation},
    {2, "isolated_partition", "Isolated partition of cgroup v2",
     "the same without a reboot; the kernel can make it invalid later without a word, for example after a core was off",
     "mkdir /sys/fs/cgroup/spine; write {cpu} to its cpuset.cpus, then isolated to its cpuset.cpus.partition", kNow,
     check_isolated_partition},
    {3, "v1_shield", "Shield of cgroup v1",
     "where cpusets belong to cgroup v1, balancing can be turned off; tasks left on the core then stay there for ever",
     "move every task to a cpuset of cores {others}, then write 0 to the root's cpuset.sched_load_balance", kNow,
     check_v1_shield},
    {4, "user_tasks", "User tasks stay off the core",
     "a task that may run there will run there as soon as the core looks idle",
     "taskset -acp {others} PID for each; for good: systemd CPUAffinity={others}", kNow, check_user_tasks},
    {5, "kernel_threads", "Movable kernel threads stay off the core",
     "threads such as rcu_preempt, kcompactd and khugepaged take the core for some 10 us",
     "taskset -cp {others} TID for each; kernel threads that start later may come back", kNow, check_kernel_threads},
    {6, "bound_kernel_threads", "Kernel threads bound to the core are quiet",
     "kworker/{cpu}, ksoftirqd/{cpu} and migration/{cpu} cannot be moved; only their causes can: items 7, 12, 20, 21",
     "mend items 7, 12, 20 and 21, then measure again", kNow, check_bound_kernel_threads},
    {7, "workqueues", "Unbound kernel work stays off the core", "write-back and the like take the core for some 10 us",
     "echo {others_mask} > /sys/devices/virtual/workqueue/cpumask", kNow, check_workqueues},
};

}  // namespace

std::span<const Item> scheduler_items() { return kSchedulerItems; }

}  // namespace lithe::host
