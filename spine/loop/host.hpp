// SPDX-License-Identifier: Apache-2.0
// Runs laws for the step, contained, and measures by the tick's clock.
#pragma once

#include <cstdint>

#include "spine/contain/fault_barrier.hpp"
#include "spine/core/rt.hpp"
#include "spine/law/sandbox.hpp"
#include "spine/loop/clock.hpp"
#include "spine/step/host.hpp"

namespace lithe::loop {

// Contract: RT · owned by the tick thread
class BarrierHost final : public step::Host {
 public:
  // Without a FaultBarrier a crash of a law ends the process, and a law is not stopped at its deadline.
  BarrierHost(const SteeredClock& clock, contain::FaultBarrier* barrier) : clock_(clock), barrier_(barrier) {}

  std::int64_t now_ns() LITHE_RT override { return clock_.now_ns(); }

  contain::Failure run(law::Sandbox& sandbox, std::int64_t deadline_ns) LITHE_RT override {
    if (barrier_ != nullptr) return barrier_->run(deadline_ns, &call_law, &sandbox);
    sandbox.call();
    return {};
  }

 private:
  LITHE_LEFT_BY_A_JUMP static void call_law(void* sandbox) LITHE_RT { static_cast<law::Sandbox*>(sandbox)->call(); }

  const SteeredClock& clock_;
  contain::FaultBarrier* barrier_;
};

}  // namespace lithe::loop
