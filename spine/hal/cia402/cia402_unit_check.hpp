// SPDX-License-Identifier: Apache-2.0
// Whether a drive's velocity is that of its position.
#pragma once

#include <cstdint>

#include "spine/core/rt.hpp"

namespace lithe::hal::cia402 {

// Many drives tell object 606Ch in turns per minute, or what else their unit objects say, unless they are told
// otherwise. Damping, velocity limits and the safe law would be wrong by that factor, so the sum of the velocities is
// held against the way that the joint went: in windows of a fifth of a second, if it moves at all. Contract: RT · one
// thread · time is an argument
class UnitCheck {
 public:
  // Samples are about `period_s` apart.
  UnitCheck(double counts_per_rev, double period_s);

  void begin() LITHE_RT;  // as if nothing had been seen
  // A sample: counts, counts per second. False: windows in a row in which they contradict each other.
  bool agrees(std::int64_t now_ns, std::int32_t position, std::int32_t velocity) LITHE_RT;
  // In the last such window: the sum of the velocities over the way.
  double ratio() const LITHE_RT { return ratio_; }

 private:
  void open(std::int64_t now_ns, std::int32_t position, std::int32_t velocity) LITHE_RT;
  void judge(double way_counts) LITHE_RT;

  double least_counts_;  // of a window that says anything
  std::int64_t window_ns_, longest_gap_ns_;
  bool open_ = false;
  std::int64_t from_ns_ = 0, last_ns_ = 0;
  std::int32_t from_counts_ = 0, last_velocity_ = 0;
  double sum_counts_ = 0;
  double ratio_ = 1;
  std::uint32_t contradictions_ = 0;  // in a row
};

}  // namespace lithe::hal::cia402
