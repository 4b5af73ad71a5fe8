// SPDX-License-Identifier: Apache-2.0
#include "spine/step/shadow.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "spine/step/bumpless.hpp"
#include "spine/step/report.hpp"

namespace lithe::step {

constexpr double kInfinite = std::numeric_limits<double>::infinity();

void Shadow::start(law::Resident& candidate, std::uint64_t tick, std::uint32_t joints) LITHE_RT {
  law_ = &candidate;
  report_ = {};
  report_.law_id = candidate.law_id;
  report_.request_id = candidate.request_id;
  report_.joint_count = joints;
  report_.from_tick = tick;
  square_nm2_.fill(0.0);
  total_ns_ = 0;
}

Shadow::Opinion Shadow::compare(const Tick& in, const Effort& active, std::int64_t law_ns) LITHE_RT {
  ++report_.ticks;
  const std::uint32_t step_ns = clamp_ns(law_ns);
  total_ns_ += step_ns;
  report_.most_ns = std::max(report_.most_ns, step_ns);
  report_.mean_ns = static_cast<std::uint32_t>(total_ns_ / report_.ticks);
  for (std::uint32_t j = 0; j < in.joints; ++j) {
    const double difference_nm = wanted_nm(effort, in, j) - wanted_nm(active, in, j);
    square_nm2_[j] += difference_nm * difference_nm;
    // Torques may be infinite here and their difference NaN: that counts as the largest difference.
    const double apart_nm = std::isfinite(difference_nm) ? std::abs(difference_nm) : kInfinite;
    report_.most_nm[j] = std::max(report_.most_nm[j], apart_nm);
    report_.rms_nm[j] = std::sqrt(square_nm2_[j] / report_.ticks);
  }
  const law::Terms& terms = law_->terms;
  const double tolerance_nm = terms.shadow_only ? 0 : terms.shadow_tolerance_nm;
  if (report_.faults != 0 || (tolerance_nm > 0 && largest_difference_nm() > tolerance_nm)) return Opinion::refuse;
  if (report_.ticks < terms.shadow_ticks) return Opinion::go_on;
  return terms.shadow_only ? Opinion::measured : Opinion::promote;
}

double Shadow::largest_difference_nm() const LITHE_RT {
  double largest_nm = 0;
  for (std::uint32_t j = 0; j < report_.joint_count; ++j) largest_nm = std::max(largest_nm, report_.most_nm[j]);
  return largest_nm;
}

}  // namespace lithe::step
