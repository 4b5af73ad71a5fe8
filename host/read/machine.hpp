// SPDX-License-Identifier: Apache-2.0
// What kind of machine this is. Off the tick.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "host/read/files.hpp"
#include "spine/core/result.hpp"

namespace lithe::host {

// `unknown` until a file says otherwise. A check for another board only is then `unknown`, too, not `not_applicable`.
enum class BoardKind : std::uint8_t { unknown, x86, raspberry_pi, jetson, other };
BoardKind board_of(const HostFiles& files);

struct Hypervisor {
  std::optional<bool> present;                                // nothing: not known
  std::vector<std::pair<std::string, std::string>> evidence;  // path and value
};

// From the flag `hypervisor` in /proc/cpuinfo, /sys/hypervisor, stolen time in /proc/stat, and the device tree.
Hypervisor hypervisor_of(const HostFiles& files);

// The cores that are on, ascending; empty when unread.
std::vector<int> online_cores(const HostFiles& files);

// Whether the first processor has a flag (x86: "constant_tsc").
bool has_cpu_flag(const HostFiles& files, const std::string& flag);

// Stolen time of a core since the boot, in ticks of 1/100 s; nothing when unread.
std::optional<long long> stolen_ticks(const HostFiles& files, int cpu);

// The running kernel: "6.1.0-18-rt-amd64, PREEMPT_RT", or without the second part. What is unread is said to be
// unknown.
struct KernelFacts {
  std::string release;              // empty: unread
  std::optional<bool> is_realtime;  // built with PREEMPT_RT; nothing: unread

  std::string words() const;
};
KernelFacts kernel_facts(const HostFiles& files);

// The running kernel's version: {6, 12}. Nothing when unread.
std::optional<std::pair<int, int>> kernel_version(const HostFiles& files);
// The same of a name as "6.12.1-arm64". Nothing when it does not begin so.
std::optional<std::pair<int, int>> kernel_version(std::string_view release);

// How often a core was interrupted since the boot, by cause: x86 and ARM name the rows differently. Off the tick.

struct DeviceCount {
  int number = 0;  // as in /proc/irq
  std::string name;
  std::uint64_t count = 0;
};

// Nothing where /proc/interrupts has no such row.
struct CoreInterrupts {
  std::optional<std::uint64_t> timer;  // LOC; ARM: arch_timer
  std::optional<std::uint64_t> cores;  // from other cores: RES, CAL, TLB; ARM: IPI0, IPI1, ...
  std::vector<DeviceCount> devices;

  std::uint64_t device_total() const;
};

// The error names the file.
Result<CoreInterrupts> count_interrupts(const HostFiles& files, int cpu);

// The cpuset partitions of cgroup v2, all of them: spine/core/host/cores.hpp tells only the one that a process is in.

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
