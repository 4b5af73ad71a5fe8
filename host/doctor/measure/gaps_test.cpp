// SPDX-License-Identifier: Apache-2.0

#include <gtest/gtest.h>
#include <sys/resource.h>

#include <atomic>
#include <thread>
#include <vector>

#include "host/doctor/measure/measure.hpp"
#include "spine/core/host/realtime.hpp"

namespace lithe::host {
namespace {

constexpr std::int64_t kMs = 1'000'000, kUs = 1'000;

// A tick of 6 us at each whole millisecond, for a second.
std::vector<Gap> ticks() {
  std::vector<Gap> gaps;
  for (std::int64_t i = 0; i < 1000; ++i) gaps.push_back({5'000 * kMs + i * kMs, 6 * kUs});
  return gaps;
}

TEST(Gaps, OfATickLieInTheFirstBinAndTheQuietestPhaseIsFarFromIt) {
  const std::vector<double> shares = phase_shares(ticks());
  ASSERT_EQ(shares.size(), 20U);
  EXPECT_DOUBLE_EQ(shares[0], 1.0);
  EXPECT_NEAR(quietest_phase_us(shares), 525, 1);  // the middle of 50 to 1000 us
}

TEST(Gaps, TheQuietestPhaseIsFoundAcrossTheEndOfTheMillisecond) {
  std::vector<double> shares(20, 0.1);
  shares[19] = shares[0] = shares[1] = 0;  // 950 to 1100 us
  EXPECT_NEAR(quietest_phase_us(shares), 25, 1);
}

TEST(Gaps, ThatSpanBinsCountInEach) {
  const std::vector<Gap> gaps = {{40 * kUs, 20 * kUs}};
  const std::vector<double> shares = phase_shares(gaps);
  EXPECT_DOUBLE_EQ(shares[0], 0.5);
  EXPECT_DOUBLE_EQ(shares[1], 0.5);
}

TEST(Gaps, OfManyPeriodsTellNothingAboutAPhase) {
  std::vector<Gap> gaps = ticks();
  gaps.push_back({7'000 * kMs, 20 * kMs});
  EXPECT_DOUBLE_EQ(phase_shares(gaps)[0], 1.0);
}

TEST(Gaps, WithoutAnyAllPhasesAreEqual) {
  EXPECT_EQ(phase_shares({}), std::vector<double>(20, 0.0));
  EXPECT_EQ(lost_share({}, 0, 1000 * kMs, 1000), 0);
}

TEST(LostShare, CountsThePeriodsThatLostMoreThanAFifth) {
  const std::vector<Gap> gaps = ticks();
  const std::int64_t from = 5'000 * kMs, until = 6'000 * kMs;
  EXPECT_EQ(lost_share(gaps, from, until, 1000), 0);  // 6 of 1000 us
  const std::vector<Gap> longer = {{5'010 * kMs, 150 * kUs}, {5'010 * kMs + 500 * kUs, 100 * kUs}};
  EXPECT_DOUBLE_EQ(lost_share(longer, from, until, 1000), 0.001);  // 250 us in one period of 1000
  EXPECT_DOUBLE_EQ(lost_share(longer, from, until, 250), 0);       // of 4000 us
}

TEST(LostShare, AStallOfManyPeriodsLosesEachOfThem) {
  const std::vector<Gap> stall = {{100 * kMs, 10 * kMs}};
  EXPECT_DOUBLE_EQ(lost_share(stall, 0, 1'000 * kMs, 1000), 0.01);
  EXPECT_DOUBLE_EQ(lost_share(stall, 0, 105 * kMs, 1000), 5.0 / 105);  // it goes on after the end
}

TEST(LostShare, ATooShortMeasurementHoldsNoRate) {
  for (const RateShare& each : rate_shares({}, 0, kUs)) EXPECT_FALSE(each.holds) << each.rate_hz;
}

// Another thread that takes the core for as long as it gets it, with the same right to it.
TEST(Measure, SeesTheGapsThatAnotherTaskOnTheCoreMakes) {
  const int cpu = allowed_cpus().front();
  std::atomic<bool> there{false}, done{false};
  std::thread other([&] {
    EXPECT_TRUE(pin_this_thread(cpu));
    setpriority(PRIO_PROCESS, 0, -20);
    there = true;
    while (!done.load(std::memory_order_relaxed)) {
    }
  });
  while (!there) std::this_thread::yield();
  const Result<Measured> seen = measure(HostFiles(), cpu, 0.2);
  done = true;
  other.join();
  ASSERT_TRUE(seen) << seen.message();
  EXPECT_EQ(seen->cpu, cpu);
  EXPECT_GE(seen->seconds, 0.2);
  EXPECT_GT(seen->gap_share, 0.2);  // a half is fair
  EXPECT_LT(seen->gap_share, 1);
  EXPECT_GT(seen->switches_per_s, 0);
  ASSERT_EQ(seen->rates.size(), 6U);
  for (const RateShare& each : seen->rates) EXPECT_FALSE(each.holds) << each.rate_hz;
}

TEST(Measure, SaysWhichCoreItCannotUse) {
  const Result<Measured> seen = measure(HostFiles(), 1'000'000, 0.1);
  ASSERT_FALSE(seen);
  EXPECT_NE(seen.message().find("1000000"), std::string::npos);
}

}  // namespace
}  // namespace lithe::host
