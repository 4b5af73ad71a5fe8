// SPDX-License-Identifier: Apache-2.0
// Release jitter of LITHE, compared with the best that this machine can do and with cyclictest.
//
// Blocks of 500 ms of a bare spin (floor), of one that writes what a tick writes, and of LITHE alternate on one core
// and in one phase, so that the machine disturbs all in the same way; cyclictest runs on the same core after each
// round. The negative control is LITHE with another busy thread on its core; its result must be bad.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <string>
#include <vector>

#include "bench/rig/cycles.hpp"
#include "bench/rig/cyclictest.hpp"
#include "bench/rig/machine.hpp"
#include "bench/rig/samples.hpp"
#include "bench/rig/spine_rig.hpp"
#include "spine/core/host/realtime.hpp"

namespace lithe::bench {
namespace {

constexpr int kRounds = 6;
constexpr int kPairsPerRound = 10;  // 500 ms of each floor and 500 ms of LITHE
constexpr int kCyclictestSeconds = 4;
constexpr std::int64_t kBlockNs = 500 * kNsPerMs;
constexpr std::int64_t kLeastNs = 1000;  // smaller differences are not significant
constexpr double kControlAtLeast = 20;   // the ratio of the control must be at least this

struct Runs {
  std::vector<Cycle> floor, writing, lithe, control;
  std::vector<std::int64_t> cyclictest_ns;
};

Runs measure(Cores cores) {
  Runs runs;
  SpineRig rig(LITHE_ROBOTS "/arm.toml", cores);
  bool cyclictest = true;
  for (int round = 0; round < kRounds; ++round) {
    for (int pair = 0; pair < kPairsPerRound; ++pair) {
      rig.run_bare_block(kBlockNs, runs.floor);
      rig.run_writing_block(kBlockNs, runs.writing);
      rig.run_block(kBlockNs, runs.lithe);
    }
    cyclictest = cyclictest && run_cyclictest(cores.spine, kCyclictestSeconds, runs.cyclictest_ns);
  }
  if (!cyclictest) runs.cyclictest_ns.clear();  // the other figures are valid without it
  const Competitor competitor(cores.spine);
  for (int block = 0; block < 6; ++block) rig.run_block(kBlockNs, runs.control);
  return runs;
}

// NaN, which becomes null, when one side was not measured.
double ratio(const std::vector<std::int64_t>& over_ns, const std::vector<std::int64_t>& under_ns, double q) {
  if (over_ns.empty() || under_ns.empty()) return std::nan("");
  return static_cast<double>(std::max(quantile_ns(over_ns, q), kLeastNs)) /
         static_cast<double>(std::max(quantile_ns(under_ns, q), kLeastNs));
}

void report(const Runs& runs) {
  const auto floor_ns = figure_ns(runs.floor, &Cycle::late_ns, true);
  const auto lithe_ns = figure_ns(runs.lithe, &Cycle::late_ns, true);
  const auto writing_ns = figure_ns(runs.writing, &Cycle::late_ns, true);
  const auto work_ns = figure_ns(runs.lithe, &Cycle::work_ns, true);
  const auto writing_work_ns = figure_ns(runs.writing, &Cycle::work_ns, true);
  const auto control_ns = figure_ns(runs.control, &Cycle::late_ns, true);
  const auto floor_raw_ns = figure_ns(runs.floor, &Cycle::late_ns, false);
  const auto lithe_raw_ns = figure_ns(runs.lithe, &Cycle::late_ns, false);
  std::vector<Cycle> all = runs.floor;
  all.insert(all.end(), runs.lithe.begin(), runs.lithe.end());
  const double control = ratio(control_ns, floor_ns, 0.999);
  JsonLine line;
  line.number("release_jitter_p999_over_floor", ratio(lithe_ns, floor_ns, 0.999))
      .number("release_jitter_p99_over_floor", ratio(lithe_ns, floor_ns, 0.99))
      .number("release_jitter_p999_over_writing", ratio(lithe_ns, writing_ns, 0.999))
      .number("work_p999_over_writing", ratio(work_ns, writing_work_ns, 0.999))
      .number("release_jitter_p999_over_floor_raw", ratio(lithe_raw_ns, floor_raw_ns, 0.999))
      // Raw over raw: the stolen time of cyclictest is not visible from outside.
      .number("release_jitter_p999_over_cyclictest", ratio(lithe_raw_ns, runs.cyclictest_ns, 0.999))
      .number("release_jitter_p50_over_cyclictest", ratio(lithe_raw_ns, runs.cyclictest_ns, 0.5))
      .quantiles("floor", floor_ns)
      .quantiles("writing", writing_ns)
      .quantiles("work", work_ns)
      .quantiles("writing_work", writing_work_ns)
      .quantiles("lithe", lithe_ns)
      .quantiles("floor_raw", floor_raw_ns)
      .quantiles("lithe_raw", lithe_raw_ns)
      .quantiles("cyclictest", runs.cyclictest_ns)
      .quantiles("control", control_ns)
      .quantiles("handoff", figure_ns(runs.lithe, &Cycle::handoff_ns, true))
      .quantiles("handoff_raw", figure_ns(runs.lithe, &Cycle::handoff_ns, false))
      .number("jitter_cycles", static_cast<double>(all.size()))
      .number("jitter_stolen_share", stolen_share(all))
      .number("floor_preempted_share", preempted_share(runs.floor))
      .number("jitter_preempted_share", preempted_share(runs.lithe))
      .number("jitter_faulting_share", share(runs.lithe, [](const Cycle& c) { return c.faults > 0; }))
      .number("control_over_floor", control)
      .flag("jitter_control_failed_as_it_must", control >= kControlAtLeast)
      .print();
}

}  // namespace
}  // namespace lithe::bench

int main() {
  using namespace lithe::bench;
  report(measure(become_a_spine()));
  return 0;
}
