// SPDX-License-Identifier: Apache-2.0
#include "spine/core/host/cores.hpp"

#include <sched.h>

#include <algorithm>
#include <iterator>
#include <string_view>
#include <thread>

#include "spine/core/host/realtime.hpp"
#include "spine/core/host/shield_group.hpp"
#include "spine/core/lookup.hpp"

namespace lithe {
namespace {

constexpr const char* kCpus = "/sys/devices/system/cpu/";

std::vector<int> both(const std::vector<int>& cpus, const std::vector<int>& others) {
  std::vector<int> all;
  std::set_union(cpus.begin(), cpus.end(), others.begin(), others.end(), std::back_inserter(all));
  return all;
}

// The whole of a text as a number; -1 if it is none that a core may have.
int core_number(std::string_view text) {
  const int number = whole_number<int>(text).value_or(-1);
  return number < CPU_SETSIZE ? number : -1;
}

// The cores of the isolated partition that a group is in, itself or with one above it. A partition that the kernel
// calls invalid isolates nothing.
std::vector<int> isolated_partition(std::string group, const std::string& root) {
  while (!group.empty()) {
    const std::string folder = root + kGroupsRoot + (group == "/" ? "" : group);
    const std::string kind = first_line(folder + "/cpuset.cpus.partition");
    if (kind == "isolated") return parse_cpu_list(first_line(folder + "/cpuset.cpus.effective"));
    if (kind == "root" || group == "/") return {};
    group.resize(std::max<std::size_t>(group.rfind('/'), 1));
  }
  return {};
}

}  // namespace

Isolation IsolatedCores::how(int cpu) const {
  if (contains(cpuset, cpu)) return Isolation::cpuset;
  return contains(boot, cpu) ? Isolation::boot : Isolation::none;
}

bool IsolatedCores::is_tickless(int cpu) const { return contains(tickless, cpu); }

std::vector<int> IsolatedCores::all() const { return both(boot, cpuset); }

std::vector<int> MachineCores::usable() const {
  std::vector<int> cpus = affinity;
  for (const int cpu : granted)
    if (!contains(affinity, cpu) && isolated.how(cpu) != Isolation::none) cpus.push_back(cpu);
  std::sort(cpus.begin(), cpus.end());
  return cpus;
}

std::vector<int> MachineCores::automatic() const {
  const bool whole =
      affinity == cores_without(granted, isolated.boot) || affinity == cores_without(granted, isolated.all());
  return whole ? usable() : affinity;
}

std::vector<int> parse_cpu_list(const std::string& text) {
  std::vector<int> cpus;
  std::string_view rest = std::string_view(text).substr(0, text.find('\n'));
  while (!rest.empty()) {
    const std::string_view part = rest.substr(0, rest.find(','));
    rest.remove_prefix(std::min(part.size() + 1, rest.size()));
    const std::size_t dash = part.find('-');
    const int first = core_number(part.substr(0, dash));
    const int last = dash == std::string_view::npos ? first : core_number(part.substr(dash + 1));
    if (first < 0 || last < first) return {};
    for (int cpu = first; cpu <= last; ++cpu) cpus.push_back(cpu);
  }
  std::sort(cpus.begin(), cpus.end());
  cpus.erase(std::unique(cpus.begin(), cpus.end()), cpus.end());
  return cpus;
}

std::string cpu_list(const std::vector<int>& cpus) {
  std::string text;
  for (std::size_t i = 0; i < cpus.size();) {
    std::size_t last = i;
    while (last + 1 < cpus.size() && cpus[last + 1] == cpus[last] + 1) ++last;
    text += (text.empty() ? "" : ",") + std::to_string(cpus[i]);
    if (last > i) text += "-" + std::to_string(cpus[last]);
    i = last + 1;
  }
  return text;
}

std::vector<int> cores_without(const std::vector<int>& cores, const std::vector<int>& others) {
  std::vector<int> rest;
  std::set_difference(cores.begin(), cores.end(), others.begin(), others.end(), std::back_inserter(rest));
  return rest;
}

bool share_a_core(const std::vector<int>& some, const std::vector<int>& others) {
  return std::any_of(some.begin(), some.end(),
                     [&](int core) { return std::binary_search(others.begin(), others.end(), core); });
}

IsolatedCores isolated_cores(pid_t pid, const std::string& root) {
  return {.boot = parse_cpu_list(first_line(root + kCpus + "isolated")),
          .cpuset = both(isolated_partition(group_of(pid == 0 ? "self" : std::to_string(pid), root), root),
                         pid == 0 ? shield_cores(root) : std::vector<int>()),
          .tickless = parse_cpu_list(first_line(root + kCpus + "nohz_full"))};
}

std::vector<int> granted_cpus(const std::vector<int>& wanted) {
  std::vector<int> granted;
  // The request ends with its thread. The thread is not moved: its present core is among those requested.
  std::thread([&] {
    if (set_allowed_cpus(0, wanted) == 0) granted = allowed_cpus();
  }).join();
  return granted;
}

MachineCores machine_cores() {
  MachineCores cores;
  cores.affinity = allowed_cpus();
  cores.online = parse_cpu_list(first_line(std::string(kCpus) + "online"));
  if (cores.online.empty()) cores.online = cores.affinity;
  cores.granted = both(granted_cpus(cores.online), shield_cores());  // the latter: to threads that join
  cores.isolated = isolated_cores();
  return cores;
}

}  // namespace lithe
