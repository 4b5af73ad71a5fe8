// SPDX-License-Identifier: Apache-2.0
#include "supervisor/core/lines.hpp"

#include <gtest/gtest.h>

namespace lithe::control {
namespace {

TEST(LineBuffer, PutsALineTogetherFromPiecesAndSplitsSeveral) {
  LineBuffer lines;
  lines.feed("ab");
  EXPECT_FALSE(lines.next());
  lines.feed("c\nd\n\ne");
  EXPECT_EQ(lines.next(), "abc");
  EXPECT_EQ(lines.next(), "d");
  EXPECT_EQ(lines.next(), "");
  EXPECT_FALSE(lines.next());
  lines.feed("\n");
  EXPECT_EQ(lines.next(), "e");
}

TEST(LineBuffer, SaysWhenALineGrowsOverItsLimit) {
  LineBuffer lines(4);
  lines.feed("1234");
  EXPECT_FALSE(lines.next());
  EXPECT_FALSE(lines.too_long());
  lines.feed("5");
  EXPECT_TRUE(lines.too_long());
}

}  // namespace
}  // namespace lithe::control
