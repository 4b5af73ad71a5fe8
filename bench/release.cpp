// SPDX-License-Identifier: Apache-2.0
// Release jitter against processor time for each way of waiting (robot file: [spine] release). One line of JSON.
// bench_release [ROUNDS]: each round has one block of every way, on the Spine's core.
#include <algorithm>
#include <array>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <string>
#include <vector>

#include "bench/rig/cycles.hpp"
#include "bench/rig/machine.hpp"
#include "bench/rig/samples.hpp"
#include "spine/loop/clock.hpp"
#include "spine/loop/release.hpp"

namespace lithe::bench {
namespace {

constexpr std::int64_t kPeriodNs = kNsPerMs;
constexpr std::int64_t kPhaseNs = 500'000;  // the Spine's
constexpr std::int64_t kBlockNs = 500 * kNsPerMs;
constexpr std::int64_t kLearnNs = 4 * kNsPerS;  // until a hybrid wait knows this board
constexpr double kControlAtLeast = 10;          // p50 of sleeping over p50 of spinning

struct Way {
  const char* name;
  loop::ReleaseWait wait;
  std::vector<Cycle> cycles;
  Had had = {};
};

void block(loop::SteeredClock& clock, Way& way, std::int64_t length_ns) {
  const ThreadToll before = thread_toll();
  run_block(
      clock, kPeriodNs, kPhaseNs, length_ns, way.cycles,
      [](std::int64_t, std::int64_t, std::uint32_t, Cycle&, Cycle*) {}, &way.wait);
  way.had.add(before, thread_toll());
}

std::array<Way, 3> measure(int rounds) {
  const auto way = [](const char* name, robot::Release how) {
    return Way{.name = name, .wait = loop::ReleaseWait(how, kPeriodNs), .cycles = {}};
  };
  std::array<Way, 3> ways = {way("spin", robot::Release::spin), way("hybrid", robot::Release::hybrid),
                             way("sleep", robot::Release::sleep)};
  const auto memory = std::make_unique<loop::ClockMemory>();
  loop::start_clock(*memory);
  loop::ClockKeeper keeper(*memory);
  loop::SteeredClock clock(*memory);
  block(clock, ways[1], kLearnNs);
  ways[1].cycles.clear();
  ways[1].had = {};
  for (int round = 0; round < rounds; ++round) {
    for (Way& each : ways) {
      keeper.renew();
      block(clock, each, kBlockNs);
    }
  }
  return ways;
}

void report(const std::array<Way, 3>& ways) {
  JsonLine line;
  std::array<double, 3> p50_ns{};
  for (std::size_t i = 0; i < ways.size(); ++i) {
    const auto late_ns = figure_ns(ways[i].cycles, &Cycle::late_ns, false);
    p50_ns[i] = static_cast<double>(std::max<std::int64_t>(quantile_ns(late_ns, 0.5), 1));
    const std::string key = std::string("release_") + ways[i].name;
    line.quantiles(key, late_ns)
        .number(key + "_over_20us", share_above(late_ns, 20'000))
        .number(key + "_over_100us", share_above(late_ns, 100'000))
        .number(key + "_processor_share", ways[i].had.share());
  }
  line.number("release_window_us", static_cast<double>(ways[1].wait.window_ns()) / 1e3)
      .flag("release_control_failed_as_it_must", p50_ns[2] / p50_ns[0] >= kControlAtLeast)
      .print();
}

}  // namespace
}  // namespace lithe::bench

int main(int argc, char** argv) {
  using namespace lithe::bench;
  become_a_spine();
  report(measure(argc > 1 ? std::max(1, std::atoi(argv[1])) : 20));
  return 0;
}
