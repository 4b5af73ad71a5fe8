// SPDX-License-Identifier: Apache-2.0
// What happened to every release of a block, and how much of it the hypervisor did.
#pragma once

#include <cstdint>
#include <vector>

#include "bench/machine.hpp"
#include "spine/core/time.hpp"
#include "spine/loop/release.hpp"

namespace lithe::bench {

struct Cycle {
  std::int64_t late_ns = 0;    // from the release to the first instruction of the tick
  std::int64_t stolen_ns = 0;  // wall time that passed without this thread having the core
  std::int64_t switches = 0;   // involuntary context switches
  std::int64_t faults = 0;     // minor page faults

  // The hypervisor had the core: time is gone, and no other thread of this machine ran instead.
  bool stolen() const { return switches == 0 && stolen_ns > (late_ns / 2 > 5000 ? late_ns / 2 : 5000); }
};

// Runs `body(release_ns, now_ns)` at every release of one block and appends what happened to each of them. A release
// that was skipped is a cycle too, late by all the time until the tick that ran instead.
template <class Body>
void run_block(const RawClock& clock, std::int64_t period_ns, std::int64_t phase_ns, std::int64_t block_ns, Body&& body,
               std::vector<Cycle>& cycles) {
  loop::ReleaseGrid grid(period_ns, phase_ns);
  grid.start(clock.now_ns());
  const std::int64_t end_ns = grid.release_ns() + block_ns;
  ThreadToll before = thread_toll();
  while (grid.release_ns() < end_ns) {
    const std::int64_t release_ns = grid.release_ns();
    const std::int64_t now_ns = loop::wait_spinning(clock, release_ns);
    body(release_ns, now_ns);
    const ThreadToll after = thread_toll();
    Cycle cycle;
    cycle.late_ns = now_ns - release_ns;
    cycle.stolen_ns = (after.wall_ns - before.wall_ns) - (after.cpu_ns - before.cpu_ns);
    cycle.switches = after.involuntary_switches - before.involuntary_switches;
    cycle.faults = after.minor_faults - before.minor_faults;
    cycles.push_back(cycle);
    before = after;
    const std::int64_t at_ns = clock.now_ns();
    for (std::uint32_t skipped = grid.advance(at_ns); skipped > 0; --skipped) {
      cycle.late_ns = at_ns - (grid.release_ns() - skipped * period_ns);
      cycles.push_back(cycle);
    }
  }
}

// Lateness of all cycles, or of those that the hypervisor did not touch.
inline std::vector<std::int64_t> lateness_ns(const std::vector<Cycle>& cycles, bool steal_aware) {
  std::vector<std::int64_t> late_ns;
  late_ns.reserve(cycles.size());
  for (const Cycle& cycle : cycles) {
    if (!steal_aware || !cycle.stolen()) late_ns.push_back(cycle.late_ns);
  }
  return late_ns;
}

}  // namespace lithe::bench
