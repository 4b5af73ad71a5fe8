// SPDX-License-Identifier: Apache-2.0
// Shadow run: a candidate runs beside the active law on the same inputs; its output is compared and discarded.
#pragma once

#include <cstdint>

#include "lithe/law.hpp"
#include "spine/core/rt.hpp"
#include "spine/law/resident.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::step {

// Contract: RT · owned by the tick thread
class Shadow {
 public:
  law::Resident* law() const LITHE_RT { return law_; }
  const wire::ShadowReport& report() const LITHE_RT { return report_; }

  void start(law::Resident& candidate, std::uint64_t tick, std::uint32_t joints) LITHE_RT;

  // The candidate's output, to be compared.
  Effort effort;

  // go_on: not decided yet. The others end the shadow run, and name its event.
  enum class Opinion : std::uint8_t { refuse, promote, measured, go_on };
  // Compares one step of the candidate on `in`, which took `law_ns`, with the active law's output `active`.
  Opinion compare(const Tick& in, const Effort& active, std::int64_t law_ns) LITHE_RT;
  // To be called when the candidate failed. It is then refused, even if its outputs agreed so far.
  void fail() LITHE_RT { report_.faults = 1; }
  void end() LITHE_RT { law_ = nullptr; }

  double largest_difference_nm() const LITHE_RT;

 private:
  law::Resident* law_ = nullptr;
  wire::ShadowReport report_{};
  JointArray square_nm2_{};  // sums
  double total_ns_ = 0;
};

}  // namespace lithe::step
