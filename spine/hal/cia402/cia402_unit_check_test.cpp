// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/cia402/cia402_unit_check.hpp"
#include "spine/core/test/units_rig.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>

namespace lithe::hal::cia402 {
namespace {

constexpr double kCountsPerRev = 4096;

// Two seconds of a motor that swings between two speeds [rev/s], told `unit` times as fast as it is; whether it passes.
bool passes(double unit, double mean, double swing, std::int64_t start_counts = 0, int gap_every = 0) {
  UnitCheck check(kCountsPerRev, 1e-3);
  bool agrees = true;
  double counts = static_cast<double>(start_counts);
  for (int i = 0; i < 2000; ++i) {
    const double rev_s = mean + swing * std::sin(0.02 * i);
    counts += 1e-3 * rev_s * kCountsPerRev;
    if (gap_every != 0 && i % gap_every < 5) continue;
    const auto raw = static_cast<std::uint32_t>(static_cast<std::int64_t>(counts));
    const auto velocity = static_cast<std::int32_t>(unit * rev_s * kCountsPerRev);
    agrees = check.agrees(i * kMs, static_cast<std::int32_t>(raw), velocity) && agrees;
  }
  return agrees;
}

TEST(UnitCheck, CountsPerSecondPassHoweverTheJointMoves) {
  for (const double mean : {0.0, 0.3, -3.0, 50.0})
    for (const double swing : {0.0, 0.2, 5.0}) EXPECT_TRUE(passes(1, mean, swing)) << mean << " " << swing;
  EXPECT_TRUE(passes(1.2, 3, 1)) << "a filter is no unit";
}

TEST(UnitCheck, AnyOtherUnitAndTheWrongSignAreFoundOut) {
  for (const double unit : {60 / kCountsPerRev, -1.0, 1e-3, 10.0, 60.0, 0.0}) EXPECT_FALSE(passes(unit, 3, 1)) << unit;
}

TEST(UnitCheck, AJointAtRestSaysNothing) { EXPECT_TRUE(passes(60, 0, 1e-3)); }

TEST(UnitCheck, WhatItCountsMayWrapAndSamplesMayBeMissing) {
  EXPECT_TRUE(passes(1, 3, 1, 2'147'480'000));
  EXPECT_TRUE(passes(1, 3, 1, 0, 50));
  EXPECT_FALSE(passes(0.01, 3, 1, 0, 500));
}

}  // namespace
}  // namespace lithe::hal::cia402
