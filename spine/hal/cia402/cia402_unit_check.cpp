// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/cia402/cia402_unit_check.hpp"

#include <algorithm>
#include <cmath>

namespace lithe::hal::cia402 {
namespace {

constexpr double kWindowS = 0.2;
constexpr double kLeastRev = 0.05;        // of the motor
constexpr double kTolerance = 0.5;        // of the longer of the two: filters lag, units are further apart
constexpr double kPeriodsPerWindow = 20;  // at least: the sum is only as good as its samples are dense
constexpr double kPeriodsPerGap = 3;      // more than that, and a sample is missing
constexpr std::uint32_t kContradictions = 3;

}  // namespace

UnitCheck::UnitCheck(double counts_per_rev, double period_s)
    : least_counts_(kLeastRev * counts_per_rev),
      window_ns_(static_cast<std::int64_t>(1e9 * std::max(kWindowS, kPeriodsPerWindow * period_s))),
      longest_gap_ns_(static_cast<std::int64_t>(1e9 * kPeriodsPerGap * period_s)) {}

void UnitCheck::begin() LITHE_RT {
  open_ = false;
  contradictions_ = 0;
}

void UnitCheck::open(std::int64_t now_ns, std::int32_t position, std::int32_t velocity) LITHE_RT {
  open_ = true;
  from_ns_ = last_ns_ = now_ns;
  from_counts_ = position;
  last_velocity_ = velocity;
  sum_counts_ = 0;
}

bool UnitCheck::agrees(std::int64_t now_ns, std::int32_t position, std::int32_t velocity) LITHE_RT {
  const std::int64_t gap_ns = now_ns - last_ns_;
  if (!open_ || gap_ns < 0 || gap_ns > longest_gap_ns_) {
    open(now_ns, position, velocity);
    return contradictions_ < kContradictions;
  }
  sum_counts_ += 0.5e-9 * static_cast<double>(gap_ns) * (static_cast<double>(velocity) + last_velocity_);
  last_ns_ = now_ns;
  last_velocity_ = velocity;
  if (now_ns - from_ns_ >= window_ns_) {
    // What it counts wraps.
    const auto way =
        static_cast<std::int32_t>(static_cast<std::uint32_t>(position) - static_cast<std::uint32_t>(from_counts_));
    judge(way);
    open(now_ns, position, velocity);
  }
  return contradictions_ < kContradictions;
}

void UnitCheck::judge(double way_counts) LITHE_RT {
  const double longer = std::max(std::abs(way_counts), std::abs(sum_counts_));
  if (longer < least_counts_) return;
  if (std::abs(way_counts - sum_counts_) <= kTolerance * longer) {
    contradictions_ = 0;
    return;
  }
  ++contradictions_;
  constexpr double kMost = 1e6;
  ratio_ = std::clamp(sum_counts_ / (std::abs(way_counts) < 1 ? 1 : way_counts), -kMost, kMost);
}

}  // namespace lithe::hal::cia402
