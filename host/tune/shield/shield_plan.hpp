// SPDX-License-Identifier: Apache-2.0
// The changes that keep all other tasks off a robot's cores for the life of the robot.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "host/read/files.hpp"
#include "host/tune/change.hpp"

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

}  // namespace lithe::host
