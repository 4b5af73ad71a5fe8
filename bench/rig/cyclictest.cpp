// SPDX-License-Identifier: Apache-2.0
#include "bench/rig/cyclictest.hpp"

#include <sched.h>

#include <array>
#include <cstdio>
#include <string>

namespace lithe::bench {
namespace {

bool may_use_fifo() {
  sched_param param{};
  param.sched_priority = 80;
  const bool granted = sched_setscheduler(0, SCHED_FIFO, &param) == 0;
  param.sched_priority = 0;
  if (granted) sched_setscheduler(0, SCHED_OTHER, &param);
  return granted;
}

}  // namespace

bool run_cyclictest(int cpu, int seconds, std::vector<std::int64_t>& latency_ns) {
  constexpr long kMostUs = 200'000;  // a later one counts as this
  const std::string command =
      "cyclictest --quiet --mlockall --threads=1 --interval=1000 --histogram=" + std::to_string(kMostUs) +
      " --affinity=" + std::to_string(cpu) + " --duration=" + std::to_string(seconds) +
      (may_use_fifo() ? " --priority=80" : "") + " 2>&1";
  std::FILE* output = popen(command.c_str(), "r");
  if (output == nullptr) {
    std::perror("bench: cyclictest");
    return false;
  }
  const std::size_t before = latency_ns.size();
  std::string text;
  std::array<char, 256> line{};
  while (std::fgets(line.data(), line.size(), output) != nullptr) {
    long latency_us = 0;
    long count = 0;
    text += line.data();
    if (std::sscanf(line.data(), "# Histogram Overflows: %ld", &count) == 1)
      latency_us = kMostUs;
    else if (std::sscanf(line.data(), "%ld %ld", &latency_us, &count) != 2)  // "000012 000345"
      continue;
    latency_ns.insert(latency_ns.end(), static_cast<std::size_t>(count), latency_us * 1000);
  }
  if (pclose(output) == 0 && latency_ns.size() > before) return true;
  std::fprintf(stderr, "bench: cyclictest failed; it said:\n%s", text.substr(0, 2000).c_str());
  latency_ns.resize(before);  // an incomplete measurement is dropped
  return false;
}

}  // namespace lithe::bench
