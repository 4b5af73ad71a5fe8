// SPDX-License-Identifier: Apache-2.0
// A release at which nothing ran counts as late; only delays by the hypervisor are left out.
#include "bench/rig/cycles.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <memory>
#include <thread>
#include <vector>

#include "bench/rig/samples.hpp"

namespace lithe::bench {
namespace {

TEST(Cycles, SkippedReleasesCountAsLateByAllTheTimeUntilTheNextTick) {
  auto memory = std::make_unique<loop::ClockMemory>();
  loop::start_clock(*memory);
  loop::SteeredClock clock(*memory);
  constexpr std::int64_t kPeriodNs = kNsPerMs;
  std::vector<Cycle> cycles;
  int bodies = 0;
  run_block(clock, kPeriodNs, 500'000, 20 * kPeriodNs, cycles,
            [&](std::int64_t release_ns, std::int64_t, std::uint32_t, Cycle&, Cycle*) {
              if (++bodies == 3) loop::wait_spinning(clock.raw(), release_ns + 5 * kPeriodNs + kPeriodNs / 2);
            });
  EXPECT_GE(cycles.size(), 20u) << "every release of the block has a cycle, whether a tick ran or not";
  EXPECT_LE(bodies + 4, static_cast<int>(cycles.size())) << "the stall of 5.5 periods swallows at least four releases";
  int late_by_periods = 0;
  for (const Cycle& cycle : cycles) late_by_periods += cycle.late_ns >= kPeriodNs ? 1 : 0;
  EXPECT_GE(late_by_periods, 4);
}

TEST(Cycles, OnlyReleasesThatPassInATickAreItsOwn) {
  auto memory = std::make_unique<loop::ClockMemory>();
  loop::start_clock(*memory);
  loop::SteeredClock clock(*memory);
  constexpr std::int64_t kPeriodNs = 50'000;  // short: on a busy core another task may run in every millisecond
  const auto owned_by = [&](bool in_the_tick) {
    bool stalled = false;
    const auto stall = [&](std::int64_t now_ns) {
      if (!stalled) loop::wait_spinning(clock.raw(), now_ns + 5 * kPeriodNs);
      stalled = true;
    };
    std::vector<Cycle> cycles;
    const auto more = [&](std::int64_t release_ns) {  // asked before the wait, as a stall of the machine would come
      if (!in_the_tick && cycles.size() == 2) stall(release_ns);
      return cycles.size() < 8;
    };
    run_while(clock, kPeriodNs, 0, more, cycles,
              [&](std::int64_t, std::int64_t woke_ns, std::uint32_t, Cycle&, Cycle*) {
                if (in_the_tick && cycles.size() >= 2) stall(woke_ns);
              });
    int own = 0;
    for (const Cycle& cycle : cycles) {
      own += cycle.own ? 1 : 0;
      EXPECT_FALSE(cycle.own && cycle.switches > 0) << "another task may have caused it";
    }
    const bool disturbed = std::ranges::any_of(cycles, [](const Cycle& cycle) { return cycle.switches > 0; });
    return disturbed ? -1 : own;
  };
  int in_the_tick = -1, before_it = -1;
  for (int attempt = 0; attempt < 50 && in_the_tick < 0; ++attempt) in_the_tick = owned_by(true);
  for (int attempt = 0; attempt < 50 && before_it < 0; ++attempt) before_it = owned_by(false);
  if (in_the_tick < 0 || before_it < 0) GTEST_SKIP() << "other tasks ran on this core in each of 50 attempts";
  EXPECT_GE(in_the_tick, 4);
  EXPECT_EQ(before_it, 0);
}

TEST(Cycles, OnlyTimeTakenWithoutASwitchIsTheHypervisors) {
  Cycle cycle;
  cycle.late_ns = 50'000;
  cycle.stolen_ns = 40'000;
  EXPECT_TRUE(cycle.stolen());
  cycle.switches = 1;
  EXPECT_FALSE(cycle.stolen()) << "another thread of this machine ran: not the hypervisor";
  cycle.switches = 0;
  cycle.sleeps = 1;
  EXPECT_FALSE(cycle.stolen()) << "this thread gave the core away itself";
  cycle.sleeps = 0;
  cycle.stolen_ns = 20'000;
  EXPECT_FALSE(cycle.stolen()) << "less than half of the lateness is explained";
  cycle.late_ns = 0;
  cycle.stolen_ns = 4'000;
  EXPECT_FALSE(cycle.stolen()) << "within the noise of the clocks";
}

TEST(Cycles, ATickThatSleepsIsNotStolen) {
  auto memory = std::make_unique<loop::ClockMemory>();
  loop::start_clock(*memory);
  loop::SteeredClock clock(*memory);
  std::vector<Cycle> cycles;
  run_block(clock, kNsPerMs, 0, 20 * kNsPerMs, cycles, [](std::int64_t, std::int64_t, std::uint32_t, Cycle&, Cycle*) {
    std::this_thread::sleep_for(std::chrono::microseconds(100));
  });
  for (const Cycle& cycle : cycles) {
    EXPECT_GE(cycle.sleeps, 1);
    EXPECT_GE(cycle.stolen_ns, 50'000);
    EXPECT_FALSE(cycle.stolen());
  }
}

TEST(Cycles, StealAwareFiguresLeaveOutWhatWasStolenAndRawOnesDoNot) {
  Cycle clean;
  clean.late_ns = 10;
  Cycle stolen;
  stolen.late_ns = 1'000'000;
  stolen.stolen_ns = 1'000'000;
  const std::vector<Cycle> cycles{clean, stolen};
  EXPECT_EQ(figure_ns(cycles, &Cycle::late_ns, true), std::vector<std::int64_t>{10});
  EXPECT_EQ(figure_ns(cycles, &Cycle::late_ns, false).size(), 2u);
  EXPECT_TRUE(figure_ns(cycles, &Cycle::cost_ns, false).empty()) << "a cycle without the figure is not a zero";
}

TEST(Samples, QuantilesAreValuesThatWereMeasured) {
  std::vector<std::int64_t> samples_ns;
  for (std::int64_t i = 1; i <= 1000; ++i) samples_ns.push_back(1001 - i);
  EXPECT_EQ(quantile_ns(samples_ns, 0.5), 500);
  EXPECT_EQ(quantile_ns(samples_ns, 0.999), 999);
  EXPECT_EQ(quantile_ns(samples_ns, 1.0), 1000);
  EXPECT_EQ(quantile_ns({}, 0.5), 0);
}

TEST(Samples, WhatWasNotMeasuredIsNullAndNotZero) {
  JsonLine line;
  line.quantiles("peer", {}).quantiles("floor", {1500}).number("ratio", std::nan(""));
  testing::internal::CaptureStdout();
  line.print();
  EXPECT_EQ(testing::internal::GetCapturedStdout(),
            "{\"peer_p50_us\": null, \"peer_p99_us\": null, \"peer_p999_us\": null, \"peer_max_us\": null, "
            "\"floor_p50_us\": 1.5, \"floor_p99_us\": 1.5, \"floor_p999_us\": 1.5, \"floor_max_us\": 1.5, "
            "\"ratio\": null}\n");
}

TEST(JsonLine, WordsThatComeFromDriversAreEscaped) {
  testing::internal::CaptureStdout();
  JsonLine().word("name", "a \"b\" \\x1b").print();
  EXPECT_EQ(testing::internal::GetCapturedStdout(), "{\"name\": \"a \\\"b\\\" \\\\x1b\"}\n");
}

}  // namespace
}  // namespace lithe::bench
