// SPDX-License-Identifier: Apache-2.0
// The cpuset partitions of cgroup v2, all of them: spine/core/host/cores.hpp tells only the one that a process is in.
#pragma once

#include <string>
#include <vector>

#include "host/read/files.hpp"

namespace lithe::host {

struct Partition {
  Reading kind;           // cpuset.cpus.partition: "isolated", "root", "isolated invalid (...)"
  Reading wanted;         // cpuset.cpus
  std::vector<int> cpus;  // cpuset.cpus.effective, ascending

  bool is_isolated() const { return kind.value == "isolated"; }
  bool is_invalid() const { return kind.value.find(" invalid") != std::string::npos; }
};

// Where cgroup v2 is mounted: "/sys/fs/cgroup", or "/sys/fs/cgroup/unified" beside cgroup v1; empty if it is not.
std::string cgroup2_folder(const HostFiles& files);

// Of all groups except plain members, and those whose files cannot be read. Six levels of groups at most.
std::vector<Partition> read_partitions(const HostFiles& files);

}  // namespace lithe::host
