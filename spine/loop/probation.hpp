// SPDX-License-Identifier: Apache-2.0
// Watches a law that has just been committed: is the robot worse off than before?
#pragma once

#include <cstdint>

#include "lithe/law.hpp"
#include "spine/core/joints.hpp"
#include "spine/core/rt.hpp"
#include "spine/law/resident.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::loop {

// Three criteria besides a fault, which ends any law at any time:
//   tracking  a joint's error grows beyond error_ratio times the largest of the time before the commit; a joint that
//             tracked better than kLeastErrorRad counts as having been that far off
//   guard     it had to clamp torque, velocity or position in most ticks of the last while, and did not before
//   budget    the step took longer than allowed kMostLong times in a row: once may be the machine's fault
// Contract: RT · owned by the tick thread · bounded work per joint
class Probation {
 public:
  static constexpr double kLeastErrorRad = 0.05;
  static constexpr std::uint32_t kMostLong = 3;

  void configure(double rate_hz);

  // A law was committed: from now on it is compared with what was seen so far.
  void start(const law::Terms& terms) LITHE_RT;
  void end() LITHE_RT { left_ = 0; }
  bool on() const LITHE_RT { return left_ > 0; }

  struct Seen {
    const Tick& in;
    std::int64_t law_ns;
    std::uint32_t flags;  // the guard's, bits of wire::telemetry_flag
  };
  // Once per tick in which a law ran. Not none: the law has to go. `confirmed` is set on the last good tick.
  wire::LawFaultKind watch(const Seen& seen, bool& confirmed) LITHE_RT;

 private:
  bool tracking_is_lost(const Tick& in) const LITHE_RT;
  void remember(const Seen& seen) LITHE_RT;

  double forget_error_ = 0;  // per tick, of the largest error
  double forget_guard_ = 0;  // per tick, of the guard's activity
  JointArray most_error_rad_{};
  double guard_activity_ = 0;  // share of recent ticks in which it clamped

  law::Terms terms_;
  std::uint32_t left_ = 0, long_steps_ = 0;
  JointArray error_before_rad_{};
  double guard_before_ = 0;
};

}  // namespace lithe::loop
