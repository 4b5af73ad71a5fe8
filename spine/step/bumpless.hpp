// SPDX-License-Identifier: Apache-2.0
// Bumpless transfer: the new law's first output equals the old law's last one; the difference is blended out.
#pragma once

#include <cmath>
#include <cstdint>

#include "lithe/law.hpp"
#include "spine/core/joints.hpp"
#include "spine/core/pd.hpp"
#include "spine/core/rt.hpp"
#include "spine/guard/guard.hpp"

namespace lithe::step {

// The torque that an effort wants at joint j in the measured state [N m].
inline double wanted_nm(const Effort& effort, const Tick& in, std::size_t j) LITHE_RT {
  return pd_of(effort, j).felt_nm(in.position_rad[j], in.velocity_rad_s[j]);
}

// The guard's slew bound applies in addition: per joint, the slower of the two decides.
// Contract: RT · owned by the tick thread
class Bumpless {
 public:
  // The next step is the first one of a new law. 0 ticks: no blend.
  void start(std::uint32_t ticks) LITHE_RT {
    ticks_ = left_ = ticks;
    fresh_ = kFirstTicks;
  }
  bool fading() const LITHE_RT { return left_ > 0; }

  // Once per tick, after the law: adds the remaining difference to its feed-forward.
  void apply(const Tick& in, const guard::Guard& guard, Effort& effort) LITHE_RT {
    if (left_ == 0) return;
    if (fresh_ > 0) {
      for (std::uint32_t j = 0; j < in.joints; ++j) {
        const double difference_nm = guard.expected_torque_nm(j) - wanted_nm(effort, in, j);
        if (fresh_ == kFirstTicks || std::abs(difference_nm) < std::abs(offset_nm_[j])) offset_nm_[j] = difference_nm;
        if (!std::isfinite(offset_nm_[j])) offset_nm_[j] = 0;
      }
      --fresh_;
    }
    const double x = static_cast<double>(left_) / ticks_;
    const double share = x * x * (3 - 2 * x);  // smoothstep: no corner at either end
    for (std::uint32_t j = 0; j < in.joints; ++j) effort.torque_nm[j] += share * offset_nm_[j];
    --left_;
  }

 private:
  // A law that differentiates an error from zero wants much in its first tick only: the smaller difference counts.
  static constexpr std::uint32_t kFirstTicks = 2;

  std::uint32_t ticks_ = 0, left_ = 0;
  std::uint32_t fresh_ = 0;
  JointArray offset_nm_{};
};

}  // namespace lithe::step
