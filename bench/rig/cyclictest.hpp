// SPDX-License-Identifier: Apache-2.0
// cyclictest (rt-tests), the usual tool: a thread that sleeps until each release.
#pragma once

#include <cstdint>
#include <vector>

namespace lithe::bench {

// Appends the wake-up latencies (whole microseconds) that cyclictest finds on `cpu` in `seconds` at 1 kHz, with
// SCHED_FIFO where this process may. False, with its output on stderr, when it is missing or fails.
bool run_cyclictest(int cpu, int seconds, std::vector<std::int64_t>& latency_ns);

}  // namespace lithe::bench
