// SPDX-License-Identifier: Apache-2.0
// The cost of a commit: interrupts and page faults of the Spine's core and thread, and telemetry before and after.
#pragma once

#include <sys/types.h>

#include <array>
#include <cstdint>
#include <optional>
#include <string_view>

#include "supervisor/core/answer.hpp"
#include "supervisor/link/spine/spine_link.hpp"

namespace lithe::control {

// Counters since boot, or since the thread started. Empty = not available on this system.
struct CoreCounts {
  std::int64_t t_ns = 0;  // time of the reading; 0 = not read
  std::optional<std::uint64_t> minor_faults, major_faults;
  std::array<std::optional<std::uint64_t>, 3> interrupts;  // kInterrupts
};
inline constexpr std::array<std::string_view, 3> kInterrupts = {"TLB", "CAL", "RES"};

// Counters of the Spine's core and tick thread. Reads two files of /proc.
CoreCounts count_core(pid_t spine, const wire::RobotInfo& info);
// The same from the text of those files.
void read_interrupts(std::string_view text, std::uint32_t cpu, CoreCounts& counts);
void read_faults(std::string_view stat, CoreCounts& counts);

// {"seconds", "minor_faults", "major_faults", "tlb", "cal", "res"}: time and differences between two readings; null =
// not available.
Json counts_json(const CoreCounts& before, const CoreCounts& after);

inline constexpr double kWindowS = 0.05;  // window before and after a commit [s]

// From the telemetry ring: time of the first call, release jitter and hand-off before and after, the largest torque
// step with its slew bound, lost ticks.
Json measure_commit(const SpineLink& spine, std::uint64_t commit_tick);

}  // namespace lithe::control
