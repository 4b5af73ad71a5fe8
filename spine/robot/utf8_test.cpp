// SPDX-License-Identifier: Apache-2.0
#include "spine/robot/utf8.hpp"

#include <gtest/gtest.h>

namespace lithe::robot {
namespace {

constexpr std::size_t kAllText = std::string_view::npos;

TEST(Utf8, TextIsText) {
  EXPECT_EQ(first_non_text(""), kAllText);
  EXPECT_EQ(first_non_text("rate_hz = 1000\t# ok\r\n"), kAllText);
  EXPECT_EQ(first_non_text("\xC3\xA9 \xE2\x82\xAC \xF0\x9F\xA4\x96"), kAllText);
}

TEST(Utf8, TheFirstBrokenByteIsFound) {
  EXPECT_EQ(first_non_text("ab\xFF"), 2U);
  EXPECT_EQ(first_non_text("ab\x80"), 2U);            // continuation without a start
  EXPECT_EQ(first_non_text("ab\xC3"), 2U);            // cut short by the end
  EXPECT_EQ(first_non_text("\xE2\x82z"), 0U);         // cut short by another character
  EXPECT_EQ(first_non_text("\xC0\xAF"), 0U);          // overlong
  EXPECT_EQ(first_non_text("\xE0\x80\x80"), 0U);      // overlong
  EXPECT_EQ(first_non_text("\xED\xA0\x80"), 0U);      // surrogate
  EXPECT_EQ(first_non_text("\xF4\x90\x80\x80"), 0U);  // beyond Unicode
  EXPECT_EQ(first_non_text(std::string_view("a\0b", 3)), 1U);
  EXPECT_EQ(first_non_text("a\x1B[0m"), 1U);
}

}  // namespace
}  // namespace lithe::robot
