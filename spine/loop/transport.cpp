// SPDX-License-Identifier: Apache-2.0
#include "spine/loop/transport.hpp"

#include <ctime>

namespace lithe::loop {

void serve_once(Handover& handover, hal::Actuators& actuators, const RawClock& clock) LITHE_RT {
  const std::int64_t start_ns = clock.now_ns();
  hal::ActuatorState& sample = handover.sample();
  actuators.cycle(handover.command(), sample, start_ns);
  sample.bus_ns = clock.now_ns() - start_ns;
  handover.finish();
}

void run_transport(Handover& handover, hal::Actuators& actuators, const ClockMemory& clock_memory, bool core_is_shared,
                   const std::atomic<bool>& stop) noexcept {
  SteeredClock clock(clock_memory);
  constexpr timespec kNap{0, 50'000};
  for (;;) {
    if (handover.pending()) {
      serve_once(handover, actuators, clock.raw());
      clock.follow();
    } else if (stop.load(std::memory_order_acquire)) {
      return;
    } else if (core_is_shared) {
      nanosleep(&kNap, nullptr);
    } else {
      spin_pause();
    }
  }
}

}  // namespace lithe::loop
