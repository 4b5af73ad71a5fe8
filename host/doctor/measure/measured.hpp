// SPDX-License-Identifier: Apache-2.0
// What `lithe doctor --measure` has seen on one core.
#pragma once

#include <optional>
#include <vector>

namespace lithe::host {

struct RateShare {
  int rate_hz = 0;
  double lost_share = 0;  // of periods in which gaps took more than kGapShareOfPeriod of the period
  bool holds = false;     // lost_share is kHeldLostShare at most
};

inline constexpr double kGapShareOfPeriod = 0.2;
inline constexpr double kHeldLostShare = 1e-3;

// What cannot be read is nothing, never 0.
struct Measured {
  int cpu = 0;
  double seconds = 0;
  double gaps_per_s = 0;  // gaps are times above 1 us in which the measuring thread did not run
  double gap_share = 0;   // of the whole time
  double gap_max_us = 0;
  std::optional<double> ticks_per_s;
  std::optional<double> device_interrupts_per_s;
  std::optional<double> core_interrupts_per_s;  // from other cores: RES, CAL, TLB; ARM: IPI
  double switches_per_s = 0;                    // the thread lost the core to another task
  double minor_faults_per_s = 0;
  double stolen_share = 0;          // time in gaps without a switch that was not the thread's own: see docs/host.md
  std::optional<double> stolen_s;   // by the hypervisor, as /proc/stat counts it
  double quietest_phase_us = 0;     // 0 to 1000: the release phase with the least gap time around it
  std::vector<double> phase_share;  // of gap time, in each 50 us of a millisecond of CLOCK_MONOTONIC
  std::vector<RateShare> rates;
};

}  // namespace lithe::host
