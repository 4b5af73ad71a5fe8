// SPDX-License-Identifier: Apache-2.0
// Checks that a drive reports its velocity in the unit that belongs to its position.
#pragma once

#include <cstdint>

#include "spine/core/rt.hpp"

namespace lithe::hal::cia402 {

// Many drives report object 606Ch in turns per minute, or in another unit that they are configured with. Damping,
// velocity limits and the safe law would then be wrong by that factor. So the velocities, summed over a window of a
// fifth of a second, are compared with the change of the position in that window. Windows without motion are ignored.
// Contract: RT · one thread · time is an argument
class UnitCheck {
 public:
  // Samples are about `period_s` apart.
  UnitCheck(double counts_per_rev, double period_s);

  void begin() LITHE_RT;  // forgets all samples
  // A sample: counts, counts per second. False: in several windows in a row, velocity and position contradict each
  // other.
  bool agrees(std::int64_t now_ns, std::int32_t position, std::int32_t velocity) LITHE_RT;
  // In the last window with motion: the summed velocity divided by the change of the position; 1 where the unit is
  // right.
  double ratio() const LITHE_RT { return ratio_; }

 private:
  void open(std::int64_t now_ns, std::int32_t position, std::int32_t velocity) LITHE_RT;
  void judge(double way_counts) LITHE_RT;

  double least_counts_;  // a window with less motion is ignored
  std::int64_t window_ns_, longest_gap_ns_;
  bool open_ = false;
  std::int64_t from_ns_ = 0, last_ns_ = 0;
  std::int32_t from_counts_ = 0, last_velocity_ = 0;
  double sum_counts_ = 0;
  double ratio_ = 1;
  std::uint32_t contradictions_ = 0;  // in a row
};

}  // namespace lithe::hal::cia402
