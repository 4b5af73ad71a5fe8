// SPDX-License-Identifier: Apache-2.0
// What the kernel says of this machine's cores: which there are, which of them this process may use, and off which the
// kernel keeps other programs. Off the tick.
#pragma once

#include <sys/types.h>

#include <cstdint>
#include <string>
#include <vector>

namespace lithe {

// How the kernel keeps other programs off a core.
enum class Isolation : std::uint8_t {
  none,    // it does not
  boot,    // isolcpus on its command line: only who asks for the core gets there
  cpuset,  // an isolated partition of cgroup v2: only who is in it
};

// Cores are numbered as the kernel does, lists of them ascend.
struct IsolatedCores {
  std::vector<int> boot;
  std::vector<int> cpuset;    // of the partition that the process is in
  std::vector<int> tickless;  // nohz_full: while one thread runs there, no timer interrupts it

  Isolation how(int cpu) const;
  bool is_tickless(int cpu) const;
  std::vector<int> all() const;  // boot and cpuset
};

struct MachineCores {
  std::vector<int> online;
  std::vector<int> affinity;  // which the process was started with
  std::vector<int> granted;   // on which the kernel would let it run if it asked: those of its cpuset
  IsolatedCores isolated;

  // What a thread may be pinned to. On a machine with isolcpus every process starts with an affinity without the
  // isolated cores, and has to ask for them.
  std::vector<int> usable() const;
  // Of these, what the program may choose by itself: an affinity that somebody has set (taskset) is kept.
  std::vector<int> automatic() const;
};

// "0,2-3", as the kernel writes it and as people read it. What is no such list is an empty one.
std::vector<int> parse_cpu_list(const std::string& text);
std::string cpu_list(const std::vector<int>& cpus);

// Of a process (0: this one); `root` holds the files of the kernel, /sys and /proc. What cannot be read is not
// isolated.
IsolatedCores isolated_cores(pid_t pid = 0, const std::string& root = "");

// Asks for cores as a thread of its own, which ends at once; which of them the kernel gave. Nothing moves.
std::vector<int> granted_cpus(const std::vector<int>& wanted);

// Of this process.
MachineCores machine_cores();

}  // namespace lithe
