// SPDX-License-Identifier: Apache-2.0
#include <gtest/gtest-spi.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <array>
#include <cstdlib>
#include <thread>
#include <vector>

#include "spine/core/histogram.hpp"
#include "spine/core/host/fd.hpp"
#include "spine/core/host/paths.hpp"
#include "spine/core/host/realtime.hpp"
#include "spine/core/lookup.hpp"
#include "spine/core/result.hpp"
#include "spine/core/test/no_alloc_rig.hpp"
#include "spine/core/time.hpp"

namespace lithe {
namespace {

struct Counters {
  std::array<std::uint64_t, kHistogramBins> bin{};
  std::uint64_t count = 0, max_ns = 0, sum_ns = 0;
};

TEST(RawClock, FollowsTheKernelsClock) {
  const RawClock clock = RawClock::calibrate();
  std::this_thread::sleep_for(std::chrono::milliseconds(50));
  // 50 ms at 100 ppm is 5 us; a clock that ignores the fitted scale is off by tens of milliseconds.
  EXPECT_LT(std::abs(clock.error_ns()), 100'000);
  EXPECT_LT(std::abs(clock.resample().error_ns()), 20'000);
}

TEST(RawClock, FollowsASlewWithinOneFit) {
  // A counter of 1 GHz; from 10 s on NTP slews CLOCK_MONOTONIC by 500 ppm.
  const auto pair_at = [](std::int64_t count) {
    return ClockPair{static_cast<std::uint64_t>(count), count + std::max<std::int64_t>(0, count - 10 * kNsPerS) / 2000};
  };
  constexpr std::int64_t kIntervalNs = 50 * kNsPerMs;
  RawClock clock(pair_at(0), pair_at(10 * kNsPerS));
  for (std::int64_t count = 10 * kNsPerS + kIntervalNs; count < 11 * kNsPerS; count += kIntervalNs) {
    clock = clock.resample(pair_at(count));
    const ClockPair next = pair_at(count + kIntervalNs);
    ASSERT_LT(std::abs(clock.to_ns(next.counter) - next.ns), 100) << "at " << count;
  }
}

TEST(RawClock, KeepsItsFitWhenAClockDidNotGoForward) {
  const RawClock clock({1000, 1000}, {2000, 2000});
  EXPECT_EQ(clock.resample({1500, 3000}).to_ns(4000), 4000);
  EXPECT_EQ(clock.resample({3000, 1500}).to_ns(4000), 4000);
}

TEST(RawClock, NeverRunsBackwardsWithinAThread) {
  const RawClock clock = RawClock::calibrate(kNsPerMs);
  std::int64_t last = clock.now_ns();
  for (int i = 0; i < 100'000; ++i) {
    const std::int64_t now = clock.now_ns();
    ASSERT_GE(now, last);
    last = now;
  }
}

TEST(Histogram, EveryDurationFallsIntoTheBinThatClaimsIt) {
  for (std::uint64_t ns = 0; ns < (std::uint64_t{1} << 33); ns = ns < 4096 ? ns + 1 : ns + ns / 97) {
    const std::size_t bin = histogram_bin(ns);
    ASSERT_LE(histogram_bin_floor_ns(bin), ns);
    ASSERT_GT(histogram_bin_floor_ns(bin + 1), ns);
  }
  EXPECT_EQ(histogram_bin(~std::uint64_t{0}), kHistogramBins - 1);
}

TEST(Histogram, QuantilesAreWithinABinOfTheTruth) {
  Counters counters;
  HistogramWriter writer(counters);
  for (int i = 1; i <= 10'000; ++i) writer.add(i);
  writer.add(-5);  // a negative duration is an error of the clock and must not be a negative index
  EXPECT_EQ(counters.count, 10'001u);
  EXPECT_EQ(counters.max_ns, 10'000u);
  EXPECT_NEAR(static_cast<double>(histogram_quantile_ns(counters.bin, 0.5)), 5000, 5000 * 0.04);
  EXPECT_NEAR(static_cast<double>(histogram_quantile_ns(counters.bin, 0.999)), 9990, 9990 * 0.04);
}

// Hidden from the optimizer, which may remove a pair of new and delete.
void allocate() {
  void* volatile memory = std::malloc(8);
  std::free(memory);
}

TEST(NoAllocScope, FailsTheTestThatAllocatesInIt) {
  if (!NoAllocScope::kCounts) GTEST_SKIP() << "a sanitizer replaces the allocator";
  EXPECT_NONFATAL_FAILURE(
      {
        const NoAllocScope scope;
        allocate();
      },
      "2 calls of the allocator");
  allocate();
  const NoAllocScope scope;  // earlier calls, and an empty scope, are no failure
}

TEST(Host, PinningToACoreThatIsNotThereSaysWhichAre) {
  const Result<> result = pin_this_thread(1000);
  ASSERT_FALSE(result);
  EXPECT_NE(result.message().find("may use cores"), std::string::npos) << result.message();
}

TEST(Paths, TheEnvironmentMovesEverything) {
  setenv("LITHE_RUN_DIR", "/somewhere", 1);
  setenv("LITHE_SHM_PREFIX", "probe", 1);
  EXPECT_EQ(control_socket_path("arm"), "/somewhere/arm.sock");
  EXPECT_EQ(shm_path("arm", "spine"), "/dev/shm/probe.arm.spine");
  unsetenv("LITHE_SHM_PREFIX");
  EXPECT_EQ(shm_path("arm", "spine"), "/dev/shm/lithe.arm.spine");
  unsetenv("LITHE_RUN_DIR");
}

TEST(Lookup, ANumberIsTheWholeTextOrItsStart) {
  EXPECT_EQ(whole_number("-1"), -1);
  EXPECT_EQ(whole_number<std::uint64_t>("ff", 16), 255u);
  for (const char* none : {"", "1 ", "x", "1x", "99999999999999999999"}) EXPECT_EQ(whole_number(none), std::nullopt);
  for (const char* none : {"-1", "+1", "4294967296"}) EXPECT_EQ(whole_number<unsigned>(none), std::nullopt);
  EXPECT_EQ(leading_number<int>("12 (discriminator 3)"), 12);
  for (const char* none : {"", "x1", " 1", "99999999999"}) EXPECT_EQ(leading_number<int>(none), 0);
}

TEST(Lookup, ListsAndTextsAreSearched) {
  EXPECT_TRUE(contains(std::vector{1, 3}, 3) && !contains(std::vector{1, 3}, 2));
  EXPECT_TRUE(has_text("a,b", ",b") && !has_text("a,b", "ba"));
}

TEST(Descriptor, IsClosedOnceAndHandedOver) {
  int ends[2];
  ASSERT_EQ(::pipe(ends), 0);
  Fd reader(ends[0]), writer(ends[1]), other;
  other = std::move(writer);
  EXPECT_FALSE(writer);
  ASSERT_EQ(other.get(), ends[1]);
  other.reset();
  char byte = 0;
  EXPECT_EQ(::read(reader.get(), &byte, 1), 0) << "its other end is closed";
}

TEST(Result, CarriesEitherAValueOrTheReason) {
  const Result<int> good = 3;
  const Result<int> bad = Error{"no"};
  EXPECT_EQ(*good, 3);
  EXPECT_FALSE(bad);
  EXPECT_EQ(bad.message(), "no");
}

}  // namespace
}  // namespace lithe
