// SPDX-License-Identifier: Apache-2.0
// What a commit cost the Spine: interrupts and page faults of its core and thread, and its own telemetry around it.
#pragma once

#include <sys/types.h>

#include <array>
#include <cstdint>
#include <optional>
#include <string_view>

#include "supervisor/link/spine_link.hpp"
#include "supervisor/core/answer.hpp"

namespace lithe::control {

// Since boot, or since the thread began. What this system does not tell is empty.
struct CoreCounts {
  std::int64_t t_ns = 0;  // when; 0 = nobody counted
  std::optional<std::uint64_t> minor_faults, major_faults;
  std::array<std::optional<std::uint64_t>, 3> interrupts;  // kInterrupts
};
inline constexpr std::array<std::string_view, 3> kInterrupts = {"TLB", "CAL", "RES"};

// Of the Spine's core and its ticking thread. Reads two files of /proc.
CoreCounts count_core(pid_t spine, const wire::RobotInfo& info);
// The same from the text of those files.
void read_interrupts(std::string_view text, std::uint32_t cpu, CoreCounts& counts);
void read_faults(std::string_view stat, CoreCounts& counts);

// {"seconds", "minor_faults", "major_faults", "tlb", "cal", "res"}: how long it was and what came between; null where
// the system does not tell or nobody counted.
swap::Json counts_json(const CoreCounts& before, const CoreCounts& after);

inline constexpr double kWindowS = 0.05;  // looked at before and after a commit

// From the telemetry ring: first call, release jitter and hand-off before and after, the largest step of a torque
// beside its slew bound, lost ticks.
swap::Json look_around(const SpineLink& spine, std::uint64_t commit_tick);

}  // namespace lithe::control
