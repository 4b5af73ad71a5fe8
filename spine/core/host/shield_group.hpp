// SPDX-License-Identifier: Apache-2.0
// The group of cgroup v2 that a shield makes for the threads of a robot (host/tune/shield/shield_plan.hpp): an isolated
// partition with the robot's cores. Its members are threads, not processes: a Spine's other threads need other cores.
// Off the tick.
#pragma once

#include <string>
#include <vector>

namespace lithe {

inline constexpr const char* kGroupsRoot = "/sys/fs/cgroup";
inline constexpr const char* kShieldGroup = "/sys/fs/cgroup/lithe.spine";

// The first line of a file of the kernel's; empty when it cannot be read.
std::string first_line(const std::string& path);

// The path of a process or thread ("self", "thread-self" or its number) below the mount of cgroup v2: the line
// "0::/path".
std::string group_of(const std::string& who, const std::string& root = "");

// The cores of that group that a thread of this process may have by joining it, ascending. Empty: there is no such
// group, the kernel does not isolate it, another robot's threads are in it, or this process has no right to join.
std::vector<int> shield_cores(const std::string& root = "");

// Moves the calling thread to the group that has the core: that of the shield, or back to the root of all groups. False
// when there is no shield, or no right; then nothing has changed for this thread.
bool join_group_with(int cpu, const std::string& root = "");

}  // namespace lithe
