// SPDX-License-Identifier: Apache-2.0
#include "spine/robot/read/report.hpp"

#include <gtest/gtest.h>

namespace lithe::robot {
namespace {

TEST(Nearest, FindsWhatWasMeant) {
  const std::vector<std::string_view> keys{"position_min_rad", "position_max_rad", "velocity_max_rad_s", "sign"};
  EXPECT_EQ(nearest("position_max_ard", keys), "position_max_rad");
  EXPECT_EQ(nearest("position_max", keys), "position_max_rad");
  EXPECT_EQ(nearest("velocty_max_rad_s", keys), "velocity_max_rad_s");
  EXPECT_EQ(nearest("sgin", keys), "sign");
}

TEST(Nearest, GuessesNothingWhenNothingIsClose) {
  EXPECT_EQ(nearest("colour", {"sign", "ratio"}), "");
  EXPECT_EQ(nearest("foo", {"top", "stop"}), "");
  EXPECT_EQ(nearest("to", {"top"}), "top");
  EXPECT_EQ(nearest("x", {}), "");
  EXPECT_EQ(nearest(std::string(100'000, 'a'), {"sign"}), "");
}

TEST(Report, ListsMistakesInTheFilesOrder) {
  Report report("a.toml");
  EXPECT_TRUE(report.empty());
  report.add({7, 2}, "second");
  report.add({3, 9}, "first");
  report.add({7, 5}, "third");
  EXPECT_FALSE(report.empty());
  EXPECT_EQ(report.error().message, "a.toml:3:9: first\na.toml:7:2: second\na.toml:7:5: third");
}

TEST(Report, DoesNotFloodTheTerminal) {
  Report report("a.toml");
  for (std::uint32_t i = 0; i < 50; ++i) report.add({i + 1, 1}, "wrong");
  EXPECT_NE(report.error().message.find("30 more"), std::string::npos);
}

}  // namespace
}  // namespace lithe::robot
