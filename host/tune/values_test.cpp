// SPDX-License-Identifier: Apache-2.0
#include "host/tune/values.hpp"

#include <gtest/gtest.h>

#include "host/read/words.hpp"

namespace lithe::host {
namespace {

TEST(Values, AMaskKeepsItsWidth) {
  EXPECT_EQ(mask_of({0, 2, 3}, "f"), "d");
  EXPECT_EQ(mask_of({0, 32}, "ffffffff,ffffffff"), "00000001,00000001");
  EXPECT_EQ(mask_of({4}, "f"), "") << "core 4 does not fit into one digit";
}

TEST(Values, EveryMaskComesBackFromItsCores) {
  for (const char* mask : {"1", "3", "d", "0f", "00000000,80000001", "ffffffff"})
    EXPECT_EQ(mask_of(*parse_mask(mask), mask), mask);
}

TEST(Values, TheBracketsNameTheValueInForce) {
  EXPECT_EQ(value_in_force("always [madvise] never"), "madvise");
  EXPECT_EQ(value_in_force("performance"), "performance");
  EXPECT_EQ(value_in_force("]odd["), "]odd[");
}

TEST(Values, CoresAreTakenOutOfAList) {
  EXPECT_EQ(cores_without({0, 1, 2}, {1}), (std::vector<int>{0, 2}));
  EXPECT_TRUE(share_a_core({0, 1}, {1}));
  EXPECT_FALSE(share_a_core({0, 2}, {1, 3}));
}

}  // namespace
}  // namespace lithe::host
