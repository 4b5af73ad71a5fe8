// SPDX-License-Identifier: Apache-2.0
#include "spine/loop/release.hpp"

#include <gtest/gtest.h>

namespace lithe::loop {
namespace {

constexpr std::int64_t kPeriodNs = kNsPerMs;

ReleaseGrid started(std::int64_t now_ns) {
  ReleaseGrid grid(kPeriodNs, 500'000);
  grid.start(now_ns);
  return grid;
}

TEST(ReleaseGrid, LiesAtItsPhaseAgainstWholeMilliseconds) {
  for (const std::int64_t now_ns : {1'000'000'000L, 1'000'400'000L, 1'000'500'000L, 1'000'999'999L}) {
    const ReleaseGrid grid = started(now_ns);
    EXPECT_EQ(grid.release_ns() % kPeriodNs, 500'000);
    EXPECT_GE(grid.release_ns(), now_ns + kPeriodNs);
    EXPECT_LT(grid.release_ns(), now_ns + 2 * kPeriodNs);
  }
}

TEST(ReleaseGrid, NeverDriftsHoweverLateATickIs) {
  ReleaseGrid grid = started(0);
  const std::int64_t first_ns = grid.release_ns();
  for (int i = 0; i < 1000; ++i) EXPECT_EQ(grid.advance(grid.release_ns() + (i % 7) * 140'000), 0u);
  EXPECT_EQ(grid.release_ns(), first_ns + 1000 * kPeriodNs);
}

TEST(ReleaseGrid, ALateReleaseRunsAndAPassedOneIsSkippedAndCounted) {
  ReleaseGrid grid = started(0);
  const std::int64_t first_ns = grid.release_ns();
  // 0.9 periods after the next release: late, not skipped.
  EXPECT_EQ(grid.advance(first_ns + kPeriodNs + 900'000), 0u);
  EXPECT_EQ(grid.release_ns(), first_ns + kPeriodNs);
  // 3.5 periods after the next one: three go by, the fourth runs late.
  EXPECT_EQ(grid.advance(grid.release_ns() + kPeriodNs + 3'500'000), 3u);
  EXPECT_EQ(grid.release_ns(), first_ns + 5 * kPeriodNs);
}

TEST(ReleaseGrid, EveryReleaseIsEitherRunOrCountedAsSkipped) {
  ReleaseGrid grid = started(0);
  const std::int64_t first_ns = grid.release_ns();
  std::int64_t run = 0;
  std::int64_t skipped = 0;
  std::int64_t now_ns = first_ns;
  for (int i = 0; i < 5000; ++i) {
    now_ns = std::max(now_ns, grid.release_ns()) + (i * 7919L) % 4'000'000L;
    skipped += grid.advance(now_ns);
    ++run;
  }
  EXPECT_EQ(grid.release_ns(), first_ns + (run + skipped) * kPeriodNs);
  EXPECT_GT(skipped, 0);
}

// What one wake-up costs on a board: mostly `usual_ns`, and one in 500 costs `rare_ns`.
std::int64_t learnt_window_ns(std::int64_t usual_ns, std::int64_t rare_ns, std::int64_t period_ns = kPeriodNs) {
  ReleaseWait wait(robot::Release::hybrid, period_ns);
  for (int i = 0; i < 100'000; ++i) wait.learn(i % 500 == 0 ? rare_ns : usual_ns + i % 1000);
  return wait.window_ns();
}

TEST(ReleaseWait, LearnsTheLatencyThatFewWakeUpsExceed) {
  EXPECT_NEAR(static_cast<double>(learnt_window_ns(60'000, 60'000)), 60'000 + 30'000, 25e3);
  EXPECT_NEAR(static_cast<double>(learnt_window_ns(10'000, 250'000)), 250'000 + 30'000, 25e3)
      << "one in 500 is above the p99.9";
}

TEST(ReleaseWait, ForgetsASlowTime) {
  ReleaseWait wait(robot::Release::hybrid, kPeriodNs);
  for (int i = 0; i < 100; ++i) wait.learn(400'000);
  EXPECT_GT(wait.window_ns(), 400'000);
  for (int i = 0; i < 30'000; ++i) wait.learn(10'000);
  EXPECT_EQ(wait.window_ns(), 50'000);
}

TEST(ReleaseWait, TheWindowIsAtMostHalfAPeriod) {
  EXPECT_EQ(learnt_window_ns(5'000'000, 5'000'000), kPeriodNs / 2);
  EXPECT_EQ(learnt_window_ns(5'000'000, 5'000'000, 125'000), 62'500);
  EXPECT_GT(learnt_window_ns(5'000'000, 5'000'000, 10 * kPeriodNs), kPeriodNs) << "a slow robot may wait longer";
}

class Wait : public testing::TestWithParam<robot::Release> {};

TEST_P(Wait, NeverReturnsBeforeTheRelease) {
  const RawClock clock = RawClock::calibrate(kNsPerMs);
  ReleaseWait wait(GetParam(), kPeriodNs);
  for (int i = 0; i < 20; ++i) {
    const std::int64_t release_ns = clock.now_ns() + 300'000;
    EXPECT_GE(wait.until(clock, release_ns), release_ns);
  }
}

INSTANTIATE_TEST_SUITE_P(EveryStrategy, Wait,
                         testing::Values(robot::Release::spin, robot::Release::hybrid, robot::Release::sleep));

}  // namespace
}  // namespace lithe::loop
