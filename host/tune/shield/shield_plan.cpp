// SPDX-License-Identifier: Apache-2.0
#include "host/tune/shield/shield_plan.hpp"

#include <algorithm>

#include "host/read/tasks.hpp"
#include "host/read/words.hpp"
#include "spine/core/host/cores.hpp"
#include "spine/core/lookup.hpp"

namespace lithe::host {
namespace {

constexpr const char* kRest = "lithe.rest";  // the group of cgroup v1 that holds all other cores

// Where a hierarchy is mounted; "" when it is not.
std::string mount_of(const HostFiles& files, const std::string& kind, const std::string& option) {
  const Reading mounts = files.read("/proc/mounts");
  for (const std::string_view line : lines_in(mounts.value)) {
    const std::vector<std::string> words = split(line);  // device, folder, type, options ...
    if (words.size() < 4 || words[2] != kind) continue;
    if (option.empty() || has_text("," + words[3] + ",", "," + option + ",")) return words[1];
  }
  return "";
}

bool holds_all(const std::vector<int>& cores, const std::vector<int>& wanted) {
  return std::ranges::includes(cores, wanted);
}

// A group whose cores the kernel would balance together with the robot's: then nothing would leave its balancing.
std::string group_in_the_way(const HostFiles& files, const std::string& mount, const std::vector<int>& cores) {
  for (const std::string& group : files.list(mount)) {
    const std::string folder = mount + "/" + group;
    const Reading its = files.read(folder + "/cpuset.cpus");
    if (!its.known() || files.read(folder + "/cpuset.sched_load_balance").value == "0") continue;
    if (group == kRest || share_a_core(parse_cpu_list(its.value), cores)) return folder;
  }
  return "";
}

Change group_setting(const std::string& path, const std::string& before, const std::string& after) {
  return {
      .item = "cpuset", .path = path, .before = before, .after = after, .why = "the robot's cores leave the balancing"};
}

// Tasks need not be members: the group alone says over which cores the kernel balances, once the root does not.
void plan_cpuset1(const HostFiles& files, const std::vector<int>& cores, ShieldPlan& plan) {
  const std::string mount = mount_of(files, "cgroup", "cpuset");
  const Reading all = files.read(mount + "/cpuset.cpus");
  const std::vector<int> rest = cores_without(parse_cpu_list(all.value), cores);
  const std::string balance = mount + "/cpuset.sched_load_balance";
  if (mount.empty() || !all.known() || rest.empty()) return;
  if (files.read(balance).value != "1")
    return plan.notes.push_back(balance + " is not 1: the kernel's balancing is left as it is");
  if (const std::string other = group_in_the_way(files, mount, cores); !other.empty())
    return plan.notes.push_back(other + " holds the robot's cores, too: the kernel's balancing is left as it is");
  const std::string folder = mount + "/" + kRest;
  plan.mechanism = Mechanism::cpuset1;
  plan.groups = {{.kind = ChangeKind::folder,
                  .item = "cpuset",
                  .path = folder,
                  .was_absent = true,
                  .why = "a group for all other cores"},
                 group_setting(folder + "/cpuset.cpus", "", cpu_list(rest)),
                 group_setting(balance, "1", "0")};
}

}  // namespace

const char* word_of(Mechanism mechanism) {
  const char* const words[] = {"boot", "cpuset2", "cpuset1", "affinity"};
  return words[static_cast<std::size_t>(mechanism)];
}

ShieldPlan shield_plan(const HostFiles& files, const std::vector<int>& cores) {
  ShieldPlan plan;
  const IsolatedCores isolated = isolated_cores(0, files.root());
  if (holds_all(isolated.all(), cores)) {
    plan.mechanism = holds_all(isolated.boot, cores) ? Mechanism::boot : Mechanism::cpuset2;
    return plan;
  }
  plan.partition = partition_plan(files, cores);
  plan_cpuset1(files, cores, plan);
  return plan;
}

std::vector<Change> moves_plan(const HostFiles& files, const std::vector<int>& cores, const Who& who) {
  std::vector<Change> moves;
  for (const Task& task : read_tasks(files, who.only).all) {
    const std::vector<int> rest = cores_without(task.cpus, cores);
    const bool left_out = who.kernel && !task.is_kernel;
    const bool stays = left_out || contains(who.leave, task.pid);
    if (task.is_bound || stays || rest.empty() || rest.size() == task.cpus.size()) continue;
    moves.push_back({.kind = ChangeKind::affinity,
                     .item = kTaskItem,
                     .path = task.path(),
                     .before = cpu_list(task.cpus),
                     .after = cpu_list(rest),
                     .why = task.name + " could run on the robot's core",
                     .start_time_ticks = task.start_time_ticks});
  }
  return moves;
}

}  // namespace lithe::host
