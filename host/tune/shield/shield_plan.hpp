// SPDX-License-Identifier: Apache-2.0
// The changes that keep all other tasks off a robot's cores for the life of the robot.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "host/read/files.hpp"
#include "host/tune/change.hpp"
#include "host/tune/journal/journal.hpp"

namespace lithe::host {

// How far other tasks are kept away. The first that this machine allows is taken.
enum class Mechanism : std::uint8_t {
  boot,      // isolcpus holds the cores: nothing has to be moved
  cpuset2,   // an isolated partition of cgroup v2 has the cores, made by us or around us: the kernel moves all tasks
  cpuset1,   // cgroup v1: tasks are moved, and the cores are out of the kernel's load balancing
  affinity,  // tasks are moved, each by itself; a task that asks for the core gets it
};

const char* word_of(Mechanism mechanism);

inline constexpr const char* kTaskItem = "tasks";  // of the changes of moves_plan()

struct ShieldPlan {
  Mechanism mechanism = Mechanism::affinity;
  std::vector<Change> partition{};   // tried first, where it is not empty; `mechanism` holds when it fails
  std::vector<Change> groups{};      // in order, after the tasks are moved; empty with boot and affinity
  std::vector<std::string> notes{};  // why not a stronger mechanism
};

// Which mechanism, and its groups. Pure: reads `files` alone. `cores`: the robot's, ascending.
ShieldPlan shield_plan(const HostFiles& files, const std::vector<int>& cores);

struct Who {
  std::vector<int> leave{};  // processes that keep the cores (the robot's)
  std::vector<int> only{};   // these processes instead of all
  bool kernel = false;       // kernel threads alone
};

// One change for each task that may run on `cores` and elsewhere, and that the kernel lets move. A task on these cores
// alone was pinned there by somebody and stays.
std::vector<Change> moves_plan(const HostFiles& files, const std::vector<int>& cores, const Who& who = {});

// The isolated partition of cgroup v2: the kernel itself keeps every other task off a robot's cores, also one that asks
// for them. One group of threads below the root (spine/core/host/shield_group.hpp); no group of somebody else is
// touched.

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
