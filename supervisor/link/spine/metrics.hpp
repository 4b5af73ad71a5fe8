// SPDX-License-Identifier: Apache-2.0
// The cost of a commit: interrupts and page faults of the Spine's core and thread, and telemetry before and after.
#pragma once

#include <sys/types.h>

#include <array>
#include <cstdint>
#include <optional>
#include <string_view>
#include <vector>

#include "spine/law/diagnosis.hpp"
#include "spine/law/tremor.hpp"
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

// How the joints followed their setpoints under one law, from the telemetry ring (about 4 s at 1 kHz).

// The error is that of one instant: a telemetry record has the setpoint of the moment in which its tick woke up, and a
// sample that was taken up to one tick earlier; so the setpoint is moved back by its velocity times that time.
struct JointControl {
  double rms_error_rad = 0, max_error_rad = 0;
  double rms_torque_nm = 0, max_torque_nm = 0;  // of the guard's output
  double at_limit = 0;                          // share of ticks in which that was torque_max_nm
  double clamped = 0;     // share of ticks in which the guard took torque from this joint: law_torque_nm differs
  double moved_rad = 0;   // distance, there and back
  double chatter_hz = 0;  // how often what the law wanted went up and down by a fifth of torque_max_nm (law::Tremor)
  law::JointSums sums;    // with the guard's output as torque
  law::Zigzag wanted{};
};

struct LawControl {
  std::uint32_t ticks = 0;  // in mode `active` under this law; others do not count
  std::uint32_t missed = 0;
  double clamped = 0;  // share of ticks in which the guard changed what the law wanted
  std::vector<JointControl> joints;
};

// Ticks (from, to] of this law that are still in the ring.
// Contract: reads at most the whole ring, some milliseconds
LawControl measure_control(const SpineLink& spine, std::uint32_t law_id, std::uint64_t from_tick,
                           std::uint64_t to_tick);

// The id of the law that ran in this tick; 0 when it ran none, or is no longer known.
std::uint32_t law_in(const SpineLink& spine, std::uint64_t tick);

}  // namespace lithe::control
