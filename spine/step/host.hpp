// SPDX-License-Identifier: Apache-2.0
// Interface that runs a law and measures how long it takes.
#pragma once

#include <cstdint>

#include "spine/contain/fault_barrier.hpp"
#include "spine/core/rt.hpp"
#include "spine/law/sandbox.hpp"

namespace lithe::step {

// What runs a law for the step; not the machine (the room host). Its answers are inputs of the step, like samples and
// commands. In the Spine it is BarrierHost, with the FaultBarrier and the clock.
// Contract: RT · one thread
class Host {
 public:
  // For durations. Only the time budget of a law on probation depends on it.
  virtual std::int64_t now_ns() LITHE_RT = 0;

  // Calls the law that is in `sandbox`. It is ended at `deadline_ns` of this clock, or when it crashes.
  virtual contain::Failure run(law::Sandbox& sandbox, std::int64_t deadline_ns) LITHE_RT = 0;

 protected:
  ~Host() = default;
};

}  // namespace lithe::step
