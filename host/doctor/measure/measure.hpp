// SPDX-License-Identifier: Apache-2.0
// Looks for gaps on one core, with a thread that spins there. Needs no privileges.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "host/read/files.hpp"
#include "spine/core/result.hpp"

namespace lithe::host {

struct RateShare {
  int rate_hz = 0;
  double lost_share = 0;  // of periods in which gaps took more than kGapShareOfPeriod of the period
  bool holds = false;     // lost_share is kHeldLostShare at most
};

inline constexpr double kGapShareOfPeriod = 0.2;
inline constexpr double kHeldLostShare = 1e-3;

// What `lithe doctor --measure` has seen on one core. What cannot be read is nothing, never 0.
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

// Waits `seconds`. Uses all of the core meanwhile: never on the core of a running Spine. The error says why the core
// cannot be used.
Result<Measured> measure(const HostFiles& files, int cpu, double seconds);

// What gaps on a core mean: for releases at a phase, and for a rate. No clock, no files.

// A time in which the core did something else. Times of CLOCK_MONOTONIC.
struct Gap {
  std::int64_t start_ns = 0;
  std::int64_t length_ns = 0;
};

inline constexpr int kPhaseBins = 20;  // of a millisecond

// The share of gap time in each bin of a millisecond; all 0 without gaps. Gaps above 500 us do not count.
std::vector<double> phase_shares(std::span<const Gap> gaps);

// The middle of the longest run of bins that are as quiet as the quietest one, in microseconds, 0 to 1000.
double quietest_phase_us(std::span<const double> shares);

// Of the periods between the two times, the share in which gaps took more than kGapShareOfPeriod. `gaps` ascending.
double lost_share(std::span<const Gap> gaps, std::int64_t from_ns, std::int64_t until_ns, int rate_hz);

// For 250, 500, 1000, 2000, 4000 and 8000 Hz.
std::vector<RateShare> rate_shares(std::span<const Gap> gaps, std::int64_t from_ns, std::int64_t until_ns);

}  // namespace lithe::host
