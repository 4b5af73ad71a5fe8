// SPDX-License-Identifier: Apache-2.0
// What gaps on a core mean: for releases at a phase, and for a rate. No clock, no files.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "host/doctor/measure/measured.hpp"

namespace lithe::host {

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
