// SPDX-License-Identifier: Apache-2.0
// cyclictest (rt-tests), the measure everyone knows: a thread that sleeps until each release.
#pragma once

#include <cstdint>
#include <vector>

namespace lithe::bench {

// Runs cyclictest at 1 kHz on `cpu`, with SCHED_FIFO where that is allowed, and appends its latencies (1 us steps).
// Ends the program with a message when cyclictest cannot run.
void run_cyclictest(int cpu, int seconds, std::vector<std::int64_t>& latency_ns);

}  // namespace lithe::bench
