// SPDX-License-Identifier: Apache-2.0
#include "host/read/partitions.hpp"

#include "spine/core/host/cores.hpp"

namespace lithe::host {
namespace {

constexpr int kDeepest = 6;

void walk(const HostFiles& files, const std::string& folder, int depth, std::vector<Partition>& found) {
  Partition each{files.read(folder + "/cpuset.cpus.partition"), files.read(folder + "/cpuset.cpus"), {}};
  // The root group, and groups without a cpuset, have neither file.
  const bool has_cpuset = !each.kind.is_absent() || !each.wanted.is_absent();
  if (has_cpuset && !(each.kind.known() && each.kind.value == "member")) {
    each.cpus = parse_cpu_list(files.read(folder + "/cpuset.cpus.effective").value);
    found.push_back(std::move(each));
  }
  if (depth == 0) return;
  for (const std::string& name : files.list(folder)) {
    const std::string inner = folder + "/" + name;
    if (files.is_folder(inner)) walk(files, inner, depth - 1, found);
  }
}

}  // namespace

std::string cgroup2_folder(const HostFiles& files) {
  for (const char* folder : {"/sys/fs/cgroup", "/sys/fs/cgroup/unified"})
    if (files.has(std::string(folder) + "/cgroup.controllers")) return folder;
  return "";
}

std::vector<Partition> read_partitions(const HostFiles& files) {
  std::vector<Partition> found;
  if (const std::string folder = cgroup2_folder(files); !folder.empty()) walk(files, folder, kDeepest, found);
  return found;
}

}  // namespace lithe::host
