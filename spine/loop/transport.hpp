// SPDX-License-Identifier: Apache-2.0
// The thread that talks to the buses, so that the tick never does.
#pragma once

#include <atomic>
#include <cstdint>

#include "spine/core/rt.hpp"
#include "spine/core/time.hpp"
#include "spine/hal/actuators.hpp"
#include "spine/loop/clock.hpp"
#include "spine/loop/handover.hpp"

namespace lithe::loop {

// One exchange: write u_k, read the replies. Called by the Transport thread, or by the tick thread in its slack where
// the Transport has no core of its own (`inline`).
// Contract: RT as far as the bus is · one caller
void serve_once(Handover& handover, hal::Actuators& actuators, const RawClock& clock) LITHE_RT;

// The Transport thread's body: serves every dispatched command until `stop`, then once more what is still pending.
// `core_is_shared`: sleep 50 us between looks instead of spinning, because others need this core too.
void run_transport(Handover& handover, hal::Actuators& actuators, const ClockMemory& clock, bool core_is_shared,
                   const std::atomic<bool>& stop) noexcept;

}  // namespace lithe::loop
