// SPDX-License-Identifier: Apache-2.0
#include "host/doctor/measure/measure.hpp"

#include <algorithm>

#include "spine/core/time.hpp"

namespace lithe::host {
namespace {

constexpr std::int64_t kBinNs = kNsPerMs / kPhaseBins;
constexpr std::int64_t kLongNs = kNsPerMs / 2;  // a longer gap covers every phase: assigned to none
constexpr double kEquallyQuiet = 0.005;         // shares of gap time that differ by less are equal

}  // namespace

std::vector<double> phase_shares(std::span<const Gap> gaps) {
  std::vector<double> shares(kPhaseBins, 0.0);
  double all_ns = 0;
  for (const Gap& gap : gaps) {
    if (gap.length_ns > kLongNs) continue;
    const std::int64_t end_ns = gap.start_ns + gap.length_ns;
    for (std::int64_t at_ns = gap.start_ns; at_ns < end_ns;) {
      const std::int64_t part_ns = std::min(end_ns, (at_ns / kBinNs + 1) * kBinNs) - at_ns;
      shares[static_cast<std::size_t>(at_ns / kBinNs % kPhaseBins)] += static_cast<double>(part_ns);
      all_ns += static_cast<double>(part_ns);
      at_ns += part_ns;
    }
  }
  for (double& each : shares) each = all_ns > 0 ? each / all_ns : 0;
  return shares;
}

double quietest_phase_us(std::span<const double> shares) {
  const double limit = *std::ranges::min_element(shares) + kEquallyQuiet;
  const auto bins = shares.size();
  std::size_t best = 0, longest = 0;
  for (std::size_t start = 0; start < bins; ++start) {
    std::size_t length = 0;
    while (length < bins && shares[(start + length) % bins] <= limit) ++length;
    if (length > longest) {
      longest = length;
      best = start;
    }
  }
  const double bin_us = 1000.0 / static_cast<double>(bins);
  const double middle_us = bin_us * (static_cast<double>(best) + static_cast<double>(longest) / 2);
  return middle_us >= 1000.0 ? middle_us - 1000.0 : middle_us;
}

double lost_share(std::span<const Gap> gaps, std::int64_t from_ns, std::int64_t until_ns, int rate_hz) {
  const std::int64_t period_ns = kNsPerS / rate_hz;
  const std::int64_t periods = (until_ns - from_ns) / period_ns;
  const auto limit_ns = static_cast<std::int64_t>(kGapShareOfPeriod * static_cast<double>(period_ns));
  std::int64_t lost = 0, present = 0, sum_ns = 0;
  for (const Gap& gap : gaps) {
    const std::int64_t end_ns = std::min(gap.start_ns + gap.length_ns, from_ns + periods * period_ns);
    for (std::int64_t at_ns = gap.start_ns; at_ns < end_ns;) {
      const std::int64_t period = (at_ns - from_ns) / period_ns;
      const std::int64_t part_ns = std::min(end_ns, from_ns + (period + 1) * period_ns) - at_ns;
      if (period != present) {
        lost += sum_ns > limit_ns ? 1 : 0;
        present = period;
        sum_ns = 0;
      }
      sum_ns += part_ns;
      at_ns += part_ns;
    }
  }
  lost += sum_ns > limit_ns ? 1 : 0;
  return periods > 0 ? static_cast<double>(lost) / static_cast<double>(periods) : 1.0;
}

std::vector<RateShare> rate_shares(std::span<const Gap> gaps, std::int64_t from_ns, std::int64_t until_ns) {
  std::vector<RateShare> rates;
  for (const int rate_hz : {250, 500, 1000, 2000, 4000, 8000}) {
    const double share = lost_share(gaps, from_ns, until_ns, rate_hz);
    rates.push_back({rate_hz, share, share <= kHeldLostShare});
  }
  return rates;
}

}  // namespace lithe::host
