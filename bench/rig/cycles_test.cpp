// SPDX-License-Identifier: Apache-2.0
// A release at which nothing ran counts as late; only delays by the hypervisor are left out.
#include "bench/rig/cycles.hpp"

#include <gtest/gtest.h>
#include <sys/mman.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <memory>
#include <span>
#include <thread>
#include <utility>
#include <vector>

#include "bench/rig/pages.hpp"
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

// The cycles of one release whose tick, or the wait before it, takes so many periods, and of all that passed meanwhile.
// Empty when something else had the core: then nothing is known about them.
std::vector<Cycle> with_a_stall(bool in_the_tick, double periods) {
  auto memory = std::make_unique<loop::ClockMemory>();
  loop::start_clock(*memory);
  loop::SteeredClock clock(*memory);
  constexpr std::int64_t kPeriodNs = 50'000;  // short: on a busy core another task may run in every millisecond
  const auto stall = [&](std::int64_t now_ns) {
    loop::wait_spinning(clock.raw(), now_ns + static_cast<std::int64_t>(periods * kPeriodNs));
  };
  const auto passing = static_cast<std::size_t>(periods);
  std::vector<Cycle> cycles;
  cycles.reserve(16);
  const auto more = [&](std::int64_t release_ns) {  // asked before the wait, as a stall of the machine would come
    if (!in_the_tick && cycles.empty()) stall(release_ns);
    return cycles.size() < 1 + passing;
  };
  run_while(clock, kPeriodNs, 0, more, cycles, [&](std::int64_t, std::int64_t woke_ns, std::uint32_t, Cycle&, Cycle*) {
    if (in_the_tick && cycles.empty()) stall(woke_ns);
  });
  const std::int64_t took_ns = clock.now_ns() - cycles.front().release_ns;
  const bool disturbed =
      std::ranges::any_of(cycles, [](const Cycle& each) { return each.switches > 0 || each.stolen_ns > 5000; });
  return disturbed || took_ns >= static_cast<std::int64_t>(1 + passing) * kPeriodNs ? std::vector<Cycle>{} : cycles;
}

TEST(Cycles, OnlyReleasesThatPassInATickAreItsOwn) {
  for (const bool in_the_tick : {true, false}) {
    for (const double periods : {1.3, 5.0}) {
      std::vector<Cycle> cycles;
      for (int attempt = 0; attempt < 50 && cycles.empty(); ++attempt) cycles = with_a_stall(in_the_tick, periods);
      if (cycles.empty()) GTEST_SKIP() << "something else had this core in each of 50 attempts";
      const auto passed = static_cast<std::ptrdiff_t>(periods);  // the last of them has a tick, which begins late
      EXPECT_EQ(std::ranges::count_if(cycles, &Cycle::own), in_the_tick ? passed : 0) << periods << " periods";
      EXPECT_EQ(std::ranges::count_if(cycles, &Cycle::missed), passed) << "the tick that ended late, and the skipped";
      EXPECT_FALSE(cycles.back().missed) << "it began late, but it ended before the next release";
    }
  }
}

TEST(Cycles, ADelayIsTheTicksOwnOnlyIfNothingElseExplainsIt) {
  Cycle tick;
  tick.release_ns = 1'000'000;
  tick.late_ns = 400'000;  // so it ran from 1.4 ms on
  tick.handoff_ns = 7;
  const auto own = [&](std::int64_t at_ns) { return delayed(tick, 3'500'000, at_ns).own; };
  EXPECT_TRUE(own(3'000'000));
  EXPECT_FALSE(own(1'400'000)) << "due before the tick began";
  EXPECT_FALSE(own(4'000'000)) << "still to come";
  tick.stolen_ns = 240'000;
  EXPECT_TRUE(own(3'000'000)) << "late by 500 us, of which less than half were stolen";
  tick.stolen_ns = 260'000;
  EXPECT_FALSE(own(3'000'000)) << "the hypervisor took more than half";
  tick.stolen_ns = 0;
  tick.switches = 1;
  EXPECT_FALSE(own(3'000'000)) << "another task ran";
  EXPECT_EQ(delayed(tick, 3'500'000, 3'000'000).late_ns, 500'000);
  EXPECT_EQ(delayed(tick, 3'500'000, 3'000'000).handoff_ns, kUnknownNs);
}

// Of cycles that took longer than 20 us: how many there are, and in how many the touch of the pages took most of it.
// In each, either the kernel has taken the pages away before, or the loop burns 100 us after it has touched them.
std::pair<int, int> long_and_paged(bool taken_away) {
  constexpr std::size_t kBytes = 128 * 4096;
  void* const memory = ::mmap(nullptr, kBytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  ::madvise(memory, kBytes, MADV_NOHUGEPAGE);
  const std::span words(static_cast<std::uint64_t*>(memory), kBytes / sizeof(std::uint64_t));
  auto clock_memory = std::make_unique<loop::ClockMemory>();
  loop::start_clock(*clock_memory);
  loop::SteeredClock clock(*clock_memory);
  touch_ns(clock, words);
  std::vector<Cycle> cycles;
  run_block(clock, kNsPerMs / 2, 0, 300 * kNsPerMs, cycles,
            [&](std::int64_t, std::int64_t, std::uint32_t, Cycle& cycle, Cycle*) {
              if (taken_away) ::madvise(memory, kBytes, MADV_DONTNEED);
              cycle.page_ns = touch_ns(clock, words);
              if (!taken_away) loop::wait_spinning(clock.raw(), clock.now_ns() + 100'000);
            });
  ::munmap(memory, kBytes);
  int are_long = 0, paged = 0;
  for (const Cycle& each : cycles) {
    if (each.switches > 0 || each.stolen() || each.work_ns <= 20'000) continue;
    ++are_long;
    paged += each.page_ns > each.work_ns / 2 ? 1 : 0;
  }
  return {are_long, paged};
}

TEST(Cycles, TimeThatAPageCostIsToldFromTimeThatTheLoopBurns) {
  const auto [taken, of_taken] = long_and_paged(true);
  const auto [burned, of_burned] = long_and_paged(false);
  if (taken < 20 || burned < 20) GTEST_SKIP() << "something else had this core in most of the cycles";
  EXPECT_GT(of_taken, taken / 2) << "128 pages that had to be made again";
  EXPECT_LT(of_burned, burned / 2) << "the same pages, which were there";
}

TEST(Cycles, ADelayIsThePagesOnlyIfTheTickSpentMostOfItWithThem) {
  Cycle tick;
  tick.release_ns = 1'000'000;
  tick.late_ns = 400'000;
  tick.page_ns = 240'000;
  EXPECT_FALSE(delayed(tick, 3'500'000, 3'000'000).paged) << "late by 500 us";
  tick.page_ns = 260'000;
  EXPECT_TRUE(delayed(tick, 3'500'000, 3'000'000).paged);
  EXPECT_FALSE(delayed(tick, 3'500'000, 1'400'000).paged) << "due before the tick began";
  tick.switches = 1;
  EXPECT_FALSE(delayed(tick, 3'500'000, 3'000'000).paged) << "another task ran";
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
