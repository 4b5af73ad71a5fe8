// SPDX-License-Identifier: Apache-2.0
#include "spine/step/report.hpp"

#include <gtest/gtest.h>

#include <limits>
#include <string>

namespace lithe::step {
namespace {

std::string written(double value, int decimals) {
  EventText words;
  words.number(value, decimals);
  return std::string(words.text());
}

TEST(EventText, NumbersAreRoundedToTheirDecimals) {
  EXPECT_EQ(written(0.15, 3), "0.150");
  EXPECT_EQ(written(0.0004, 3), "0.000");
  EXPECT_EQ(written(12.3456, 2), "12.35");
  EXPECT_EQ(written(-1.5, 1), "-1.5");
  EXPECT_EQ(written(30.6, 0), "31");
  EXPECT_EQ(written(0, 0), "0");
}

TEST(EventText, WhatIsNoUsefulNumberStaysShort) {
  EXPECT_EQ(written(std::numeric_limits<double>::infinity(), 1), "inf");
  EXPECT_EQ(written(-std::numeric_limits<double>::infinity(), 1), "-inf");
  EXPECT_EQ(written(std::numeric_limits<double>::quiet_NaN(), 6), "nan");
  EXPECT_EQ(written(-1e300, 9), "-1000000000.000000") << "six decimals at most";
}

}  // namespace
}  // namespace lithe::step
