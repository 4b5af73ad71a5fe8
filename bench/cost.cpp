// SPDX-License-Identifier: Apache-2.0
// The time of a tick without its law: from wake-up to the end of the tick, minus the time of the law.
//
// The robots take turns in blocks of 500 ms. The negative control compares the robot with 32 joints with the one with a
// single joint: without a difference there, the bench would measure nothing.
#include <cstdio>
#include <memory>
#include <string>
#include <vector>

#include "bench/rig/cycles.hpp"
#include "bench/rig/machine.hpp"
#include "bench/rig/samples.hpp"
#include "bench/rig/spine_rig.hpp"
#include "spine/core/host/realtime.hpp"

namespace lithe::bench {
namespace {

constexpr int kRounds = 8;
constexpr std::int64_t kBlockNs = 500 * kNsPerMs;
constexpr double kControlAtLeast = 1.3;

struct Subject {
  const char* key;
  const char* robot_file;
  std::vector<Cycle> cycles;
};

void measure(Cores cores, std::vector<Subject>& subjects) {
  for (int round = 0; round < kRounds; ++round) {
    for (Subject& subject : subjects) {
      SpineRig rig(subject.robot_file, cores);  // alone: another rig's Transport would share the partner core
      rig.run_block(kBlockNs, subject.cycles);
    }
  }
}

void report(const std::vector<Subject>& subjects) {
  JsonLine line;
  std::vector<double> median_ns;
  for (const Subject& subject : subjects) {
    const auto cost_ns = figure_ns(subject.cycles, &Cycle::cost_ns, true);
    median_ns.push_back(static_cast<double>(quantile_ns(cost_ns, 0.5)));
    line.quantiles(std::string("tick_cost_") + subject.key, cost_ns);
    line.number(std::string("tick_cost_p50_us_") + subject.key, median_ns.back() / 1e3);
    line.number(std::string("tick_cost_stolen_share_") + subject.key, stolen_share(subject.cycles));
    line.number(std::string("tick_cost_preempted_share_") + subject.key, preempted_share(subject.cycles));
  }
  const double control = median_ns.back() / median_ns.front();
  line.number("cost_control_32j_over_1j", control);
  line.flag("cost_control_failed_as_it_must", control >= kControlAtLeast);
  line.print();
}

}  // namespace
}  // namespace lithe::bench

int main() {
  using namespace lithe::bench;
  const Cores cores = become_a_spine();
  std::vector<Subject> subjects{{"1j", LITHE_ROBOTS "/arm.toml", {}},
                                {"8j", LITHE_ROBOTS "/arm8.toml", {}},
                                {"32j", LITHE_ROBOTS "/arm32.toml", {}}};
  measure(cores, subjects);
  report(subjects);
  return 0;
}
