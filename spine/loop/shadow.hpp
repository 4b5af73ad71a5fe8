// SPDX-License-Identifier: Apache-2.0
// A candidate that runs beside the active law: same live inputs, its output is compared and thrown away.
#pragma once

#include <cstdint>

#include "lithe/law.hpp"
#include "spine/core/rt.hpp"
#include "spine/law/resident.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::loop {

// Contract: RT · owned by the tick thread
class Shadow {
 public:
  law::Resident* law() const LITHE_RT { return law_; }
  const wire::ShadowReport& report() const LITHE_RT { return report_; }

  void start(law::Resident& candidate, std::uint64_t tick, std::uint32_t joints) LITHE_RT;

  enum class Opinion : std::uint8_t { go_on, promote, refuse };
  // One step of the candidate was made on `in`, in `law_ns`; `active` is what the active law wanted.
  Opinion compare(const Tick& in, const Effort& active, const Effort& candidate, std::int64_t law_ns) LITHE_RT;
  // It failed: refused whatever it agreed to before.
  void fail() LITHE_RT { report_.faults = 1; }
  void end() LITHE_RT { law_ = nullptr; }

  double largest_difference_nm() const LITHE_RT;

 private:
  law::Resident* law_ = nullptr;
  wire::ShadowReport report_{};
  JointArray square_nm2_{};  // sums
  double total_ns_ = 0;
};

}  // namespace lithe::loop
