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

}  // namespace lithe::host
