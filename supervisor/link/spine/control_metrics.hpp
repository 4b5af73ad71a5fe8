// SPDX-License-Identifier: Apache-2.0
// How the joints followed their setpoints under one law, from the telemetry ring (about 4 s at 1 kHz).
#pragma once

#include <cstdint>
#include <vector>

#include "spine/law/diagnosis.hpp"
#include "spine/law/tremor.hpp"
#include "supervisor/link/spine/spine_link.hpp"

namespace lithe::control {

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
