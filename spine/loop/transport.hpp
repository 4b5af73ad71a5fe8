// SPDX-License-Identifier: Apache-2.0
// The Transport thread: does the bus exchanges, so that the tick does not wait for them.
#pragma once

#include <atomic>

#include "spine/core/rt.hpp"
#include "spine/core/time.hpp"
#include "spine/hal/actuators.hpp"
#include "spine/loop/clock.hpp"
#include "spine/loop/handover.hpp"

namespace lithe::loop {

// One exchange: write u_k, read the replies. Called by the Transport thread, or by the tick thread after the tick where
// the Transport has no core of its own (`inline`).
// Contract: RT if the bus is · one caller
void serve_once(Handover& handover, hal::Actuators& actuators, const RawClock& clock) LITHE_RT;

// The Transport thread's body: serves every dispatched command until `stop`, then a command that is still pending.
// `core_is_shared`: sleep 50 us between looks instead of spinning, because others need this core too.
void run_transport(Handover& handover, hal::Actuators& actuators, const ClockMemory& clock, bool core_is_shared,
                   const std::atomic<bool>& stop) noexcept;

}  // namespace lithe::loop
