// SPDX-License-Identifier: Apache-2.0
#include "spine/loop/probation.hpp"

#include <algorithm>
#include <cmath>

namespace lithe::loop {
namespace {

constexpr double kErrorMemoryS = 1.0;
constexpr double kGuardMemoryS = 0.2;  // a step of the setpoint may saturate a good law for a tenth of a second
constexpr double kBusy = 0.8, kCalm = 0.4;
constexpr std::uint32_t kClamped = wire::telemetry_flag::kTorqueClamped | wire::telemetry_flag::kVelocityClamped |
                                   wire::telemetry_flag::kPositionClamped;

double error_rad(const Tick& in, std::uint32_t j) LITHE_RT {
  return std::abs(in.setpoint_position_rad[j] - in.position_rad[j]);
}

}  // namespace

void Probation::configure(double rate_hz) {
  forget_error_ = std::exp(-1.0 / (kErrorMemoryS * rate_hz));
  forget_guard_ = std::exp(-1.0 / (kGuardMemoryS * rate_hz));
}

void Probation::start(const law::Terms& terms) LITHE_RT {
  terms_ = terms;
  left_ = terms.probation_ticks;
  long_steps_ = 0;
  error_before_rad_ = most_error_rad_;
  guard_before_ = guard_activity_;
}

wire::LawFaultKind Probation::watch(const Seen& seen, bool& confirmed) LITHE_RT {
  confirmed = false;
  remember(seen);
  if (left_ == 0) return wire::LawFaultKind::none;
  if (tracking_is_lost(seen.in)) return wire::LawFaultKind::tracking_lost;
  if (guard_activity_ > kBusy && guard_before_ < kCalm) return wire::LawFaultKind::guard_busy;
  if (long_steps_ >= kMostLong) return wire::LawFaultKind::overran;
  confirmed = --left_ == 0;
  return wire::LawFaultKind::none;
}

bool Probation::tracking_is_lost(const Tick& in) const LITHE_RT {
  if (!(terms_.probation_error_ratio > 0)) return false;
  bool lost = false;
  for (std::uint32_t j = 0; j < in.joints; ++j) {
    lost |= error_rad(in, j) > terms_.probation_error_ratio * std::max(error_before_rad_[j], kLeastErrorRad);
  }
  return lost;
}

void Probation::remember(const Seen& seen) LITHE_RT {
  for (std::uint32_t j = 0; j < seen.in.joints; ++j) {
    most_error_rad_[j] = std::max(error_rad(seen.in, j), most_error_rad_[j] * forget_error_);
  }
  const double clamped = (seen.flags & kClamped) != 0 ? 1.0 : 0.0;
  guard_activity_ = clamped + (guard_activity_ - clamped) * forget_guard_;
  const bool too_long = terms_.budget_ns > 0 && seen.law_ns > terms_.budget_ns;
  long_steps_ = too_long ? long_steps_ + 1 : 0;
}

}  // namespace lithe::loop
