// SPDX-License-Identifier: Apache-2.0
// This machine's cores, from the kernel: all cores, those this process may use, and isolated ones. Off the tick.
#pragma once

#include <sys/types.h>

#include <cstdint>
#include <string>
#include <vector>

namespace lithe {

// Kind of isolation of a core.
enum class Isolation : std::uint8_t {
  none,    // not isolated
  boot,    // isolcpus: only threads that request the core run there
  cpuset,  // isolated partition of cgroup v2: only its members run there
};

// Cores have the kernel's numbers; lists are ascending.
struct IsolatedCores {
  std::vector<int> boot;
  std::vector<int> cpuset;  // of the partition that the process is in, or that its threads may join (shield_group.hpp)
  std::vector<int> tickless;  // nohz_full: while one thread runs there, no timer interrupts it

  Isolation how(int cpu) const;
  bool is_tickless(int cpu) const;
  std::vector<int> all() const;  // boot and cpuset
};

struct MachineCores {
  std::vector<int> online;
  std::vector<int> affinity;  // at the start of the process
  std::vector<int> granted;   // cores that the kernel would grant: those of its cpuset
  IsolatedCores isolated;

  // What a thread may be pinned to. On a machine with isolcpus every process starts with an affinity without the
  // isolated cores, and has to ask for them.
  std::vector<int> usable() const;
  // The cores that may be chosen automatically: an affinity set by the user (taskset) is kept.
  std::vector<int> automatic() const;
};

// "0,2-3", as the kernel writes it and as people read it. Invalid text gives an empty list.
std::vector<int> parse_cpu_list(const std::string& text);
std::string cpu_list(const std::vector<int>& cpus);

// The cores that are in `cores` and not in `others`, and whether they have one in common; both lists ascending.
std::vector<int> cores_without(const std::vector<int>& cores, const std::vector<int>& others);
bool share_a_core(const std::vector<int>& some, const std::vector<int>& others);

// Of a process (0: this one); `root` holds the files of the kernel, /sys and /proc. What cannot be read is not
// isolated.
IsolatedCores isolated_cores(pid_t pid = 0, const std::string& root = "");

// Requests cores in a temporary thread and returns those the kernel granted. The caller's affinity does not change.
std::vector<int> granted_cpus(const std::vector<int>& wanted);

// Of this process.
MachineCores machine_cores();

}  // namespace lithe
