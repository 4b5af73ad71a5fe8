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

class Wait : public testing::TestWithParam<robot::Release> {};

TEST_P(Wait, NeverReturnsBeforeTheRelease) {
  const RawClock clock = RawClock::calibrate(kNsPerMs);
  for (int i = 0; i < 20; ++i) {
    const std::int64_t release_ns = clock.now_ns() + 300'000;
    EXPECT_GE(wait_for_release(GetParam(), clock, release_ns, 100'000), release_ns);
  }
}

INSTANTIATE_TEST_SUITE_P(EveryStrategy, Wait,
                         testing::Values(robot::Release::spin, robot::Release::hybrid, robot::Release::sleep));

}  // namespace
}  // namespace lithe::loop
