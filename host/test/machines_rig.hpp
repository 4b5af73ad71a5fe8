// SPDX-License-Identifier: Apache-2.0
// Whole machines made of files, with four cores, of which core 1 is judged. Each has all files that a check may read.
#pragma once

#include <string>

#include "host/test/root_rig.hpp"

namespace lithe::host {

inline constexpr int kJudged = 1;

// A task of one thread. Flags as in /proc/PID/stat: PF_KTHREAD, PF_NO_SETAFFINITY. Policy: 0 other, 1 FIFO.
struct FakeTask {
  int pid = 0;
  std::string name;
  std::string cpus = "0-3";
  unsigned long flags = 0;
  int policy = 0;
  std::string locked = "0 kB";
};
inline constexpr unsigned long kKernelThread = 0x00200000, kBoundThread = 0x04200000;

void add_task(const FakeRoot& root, const FakeTask& task);

// Debian on a PC, nothing set: tier D.
void put_desktop(const FakeRoot& root);
// The same, other tasks kept off core 1 by their affinity: tier C.
void put_pinned(const FakeRoot& root);
// The same in an isolated partition of cgroup v2, interrupts elsewhere, memory may be locked: tier B.
void put_partition(const FakeRoot& root);
// Booted with isolcpus, nohz_full and rcu_nocbs, frequency fixed: tier A.
void put_booted(const FakeRoot& root);
// A Raspberry Pi 5: ARM, other rows of interrupts, an interrupt controller that does not tell; booted with isolcpus.
void put_pi(const FakeRoot& root);
// A virtual machine with cgroup v1 and a Spine that is SCHED_FIFO.
void put_fifo(const FakeRoot& root);

}  // namespace lithe::host
