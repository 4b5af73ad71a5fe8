// SPDX-License-Identifier: Apache-2.0
// The isolated partition of cgroup v2: the kernel itself keeps every other task off a robot's cores, also one that asks
// for them. One group of threads below the root (spine/core/host/shield_group.hpp); no group of somebody else is
// touched.
#pragma once

#include <string>
#include <vector>

#include "host/read/files.hpp"
#include "host/tune/journal/apply.hpp"

namespace lithe::host {

// Of the changes that make a partition, and of the tasks whose cores it would forget.
inline constexpr const char* kPartitionItem = "partition";

// The changes, in order; empty when it is in force, or when this machine has no cpusets of cgroup v2. Only reads.
std::vector<Change> partition_plan(const HostFiles& files, const std::vector<int>& cores);

struct MadePartition {
  std::vector<Step> steps{};
  std::string why_not{};  // empty: it is in force. Else nothing of it is left, but for what is in `steps` as refused
};

// Makes it. `only`: the tasks of these processes alone are looked at; for tests. The error is the journal's.
Result<MadePartition> make_partition(Journal& journal, const Writer& writer, const std::vector<Change>& changes,
                                     const std::vector<int>& only = {});

// Undoes the partition that stands in the journal, if there is one, and gives every task the cores back that it had
// chosen: kernels before 6.2 forget them. The steps are empty when there is none.
Result<std::vector<Step>> unmake_partition(Journal& journal, const Writer& writer, const std::vector<int>& only = {});

// What the kernel says about it now: "isolated", "isolated invalid (...)"; empty: there is none.
std::string partition_state(const HostFiles& files);

}  // namespace lithe::host
