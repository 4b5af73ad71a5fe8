// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/canopen/canopen_words.hpp"

#include <gtest/gtest.h>

namespace lithe::hal::canopen {
namespace {

TEST(CanopenWords, AnEmergencyWithoutANameOfItsOwnHasItsClass) {
  EXPECT_EQ(emergency_name(0x4210), "too hot");
  EXPECT_EQ(emergency_name(0x43ff), "temperature");
  EXPECT_EQ(emergency_name(0xff01), "of the maker's own");
}

TEST(CanopenWords, HexHasAtLeastThatManyDigits) {
  EXPECT_EQ(hex(0, 2), "00");
  EXPECT_EQ(hex(0x42, 4), "0042");
  EXPECT_EQ(hex(0xdeadbeef, 4), "deadbeef");
}

}  // namespace
}  // namespace lithe::hal::canopen
