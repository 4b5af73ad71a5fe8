// SPDX-License-Identifier: Apache-2.0
// Measurements of every release of a block, and the part of the delay that the hypervisor caused.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "bench/rig/machine.hpp"
#include "spine/core/time.hpp"
#include "spine/loop/clock.hpp"
#include "spine/loop/release.hpp"

namespace lithe::bench {

inline constexpr std::int64_t kUnknownNs = -1;

struct Cycle {
  std::int64_t late_ns = 0;              // from the release to the first instruction of the tick
  std::int64_t stolen_ns = 0;            // wall time that passed without this thread having the core
  std::int64_t switches = 0;             // involuntary context switches
  std::int64_t sleeps = 0;               // voluntary ones: the thread itself gave the core away
  std::int64_t faults = 0;               // minor page faults
  std::int64_t handoff_ns = kUnknownNs;  // wake-up to hand-over of the command; bare and skipped cycles have none
  std::int64_t cost_ns = kUnknownNs;     // the whole tick without its law; likewise
  std::int64_t bus_ns = kUnknownNs;      // the exchange that brought the tick's sample; likewise
  std::int64_t work_ns = kUnknownNs;     // from wake-up to the end of what is done at a release; skipped ones have none
  std::int64_t page_ns = 0;              // of it: a touch of the pages that the telemetry record is written to
  std::int64_t release_ns = 0;           // when it was due, CLOCK_MONOTONIC
  bool own = false;                      // due while the tick before it ran: see delayed()
  bool paged = false;                    // own, and that tick spent most of the delay with its pages
  bool missed = false;                   // as in docs/rt.md: no tick ran, or it ended after the next release

  // The hypervisor had the core: time is missing, no other thread of this machine ran instead, this one never slept.
  bool stolen() const { return switches == 0 && sleeps == 0 && stolen_ns > std::max<std::int64_t>(5000, late_ns / 2); }
};

inline std::int64_t spine_period_ns(double rate_hz) { return static_cast<std::int64_t>(1e9 / rate_hz + 0.5); }

// The release of `at_ns`, which had to wait until the tick `ran` ended. It is that tick's own if it was due in it, and
// neither another task nor the hypervisor explains the delay.
inline Cycle delayed(const Cycle& ran, std::int64_t ended_ns, std::int64_t at_ns) {
  Cycle cycle = ran;
  cycle.handoff_ns = cycle.cost_ns = cycle.bus_ns = cycle.work_ns = kUnknownNs;
  cycle.release_ns = at_ns;
  cycle.late_ns = ended_ns - at_ns;
  const bool in_the_tick = at_ns > ran.release_ns + ran.late_ns && at_ns <= ended_ns;
  cycle.own = in_the_tick && cycle.switches == 0 && !cycle.stolen();
  cycle.paged = cycle.own && cycle.page_ns > cycle.late_ns / 2;
  return cycle;
}

// Runs `body(release_ns, woke_ns, skipped, cycle, cycle_before)` at every release as long as `more(release_ns)` holds,
// and appends a Cycle for each of them. Waits by spinning, if no other way is given: then a cycle that slept never
// counts as stolen. A skipped release has a Cycle too; it is late by the whole time until the next tick that ran.
template <class More, class Body>
void run_while(loop::SteeredClock& clock, std::int64_t period_ns, std::int64_t phase_ns, More&& more,
               std::vector<Cycle>& cycles, Body&& body, loop::ReleaseWait* wait = nullptr) {
  loop::ReleaseGrid grid(period_ns, phase_ns);
  grid.start(clock.now_ns());
  const std::size_t first = cycles.size();
  ThreadToll before = thread_toll();
  Cycle waited;  // what delayed() said of this release
  for (std::uint32_t skipped = 0; more(grid.release_ns());) {
    const std::int64_t release_ns = grid.release_ns();
    const std::int64_t woke_ns =
        wait != nullptr ? wait->until(clock.raw(), release_ns) : loop::wait_spinning(clock.raw(), release_ns);
    Cycle cycle;
    body(release_ns, woke_ns, skipped, cycle, cycles.size() == first ? nullptr : &cycles.back());
    cycle.work_ns = clock.now_ns() - woke_ns;
    const ThreadToll after = thread_toll();
    cycle.late_ns = woke_ns - release_ns;
    cycle.release_ns = release_ns;
    cycle.stolen_ns = (after.wall_ns - before.wall_ns) - (after.cpu_ns - before.cpu_ns);
    cycle.switches = after.involuntary_switches - before.involuntary_switches;
    cycle.sleeps = after.voluntary_switches - before.voluntary_switches;
    cycle.faults = after.minor_faults - before.minor_faults;
    cycle.own = waited.own;
    cycle.paged = waited.paged;
    before = after;
    clock.follow();
    const std::int64_t now_ns = clock.now_ns();
    skipped = grid.advance(now_ns);
    cycle.missed = now_ns > release_ns + period_ns;
    for (std::uint32_t i = skipped; i > 0; --i)
      cycles.push_back(delayed(cycle, now_ns, grid.release_ns() - i * period_ns));
    waited = delayed(cycle, now_ns, grid.release_ns());
    cycles.push_back(cycle);  // last, because the next tick adds figures to this one
  }
}

// The same for one block of a given length.
template <class Body>
void run_block(loop::SteeredClock& clock, std::int64_t period_ns, std::int64_t phase_ns, std::int64_t block_ns,
               std::vector<Cycle>& cycles, Body&& body, loop::ReleaseWait* wait = nullptr) {
  std::int64_t end_ns = INT64_MAX;
  const auto more = [&](std::int64_t release_ns) {
    if (end_ns == INT64_MAX) end_ns = release_ns + block_ns;  // from the first release
    return release_ns < end_ns;
  };
  run_while(clock, period_ns, phase_ns, more, cycles, body, wait);
}

// One figure of all cycles that have it, or only of those without stolen time.
inline std::vector<std::int64_t> figure_ns(const std::vector<Cycle>& cycles, std::int64_t Cycle::* figure,
                                           bool steal_aware) {
  std::vector<std::int64_t> values_ns;
  values_ns.reserve(cycles.size());
  for (const Cycle& cycle : cycles)
    if (cycle.*figure != kUnknownNs && !(steal_aware && cycle.stolen())) values_ns.push_back(cycle.*figure);
  return values_ns;
}

inline double share(const std::vector<Cycle>& cycles, bool (*holds)(const Cycle&)) {
  const auto count = std::count_if(cycles.begin(), cycles.end(), holds);
  return cycles.empty() ? 0.0 : static_cast<double>(count) / static_cast<double>(cycles.size());
}

inline double stolen_share(const std::vector<Cycle>& cycles) {
  return share(cycles, [](const Cycle& c) { return c.stolen(); });
}

inline double preempted_share(const std::vector<Cycle>& cycles) {
  return share(cycles, [](const Cycle& c) { return c.switches > 0; });
}

}  // namespace lithe::bench
