// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/canopen/canopen_text.hpp"

#include <gtest/gtest.h>

#include <cstdint>

#include "spine/hal/canopen/canopen_sdo.hpp"

namespace lithe::hal::canopen {
namespace {

TEST(CanopenWords, AnEmergencyWithoutANameOfItsOwnHasItsClass) {
  EXPECT_EQ(emergency_name(0x4210), "too hot");
  EXPECT_EQ(emergency_name(0x43ff), "temperature");
  EXPECT_EQ(emergency_name(0xff01), "of the maker's own");
}

TEST(CanopenWords, HexHasAtLeastThatManyDigits) {
  EXPECT_EQ(frame_text(emergency_frame(3, {0x42, 0}), {}).text,
            "emergency 0042h of the maker's own, error register 00h");
  const auto abort = [](std::uint32_t code) {
    return frame_text(sdo_abort(0x583, {object::kDeviceType, 0}, code), {}).text;
  };
  EXPECT_EQ(abort(0x42), "SDO abort 1000h:0 device type: a reason of the maker's own (00000042h)");
  EXPECT_EQ(abort(0xdeadbeef), "SDO abort 1000h:0 device type: a reason of the maker's own (deadbeefh)");
}

}  // namespace
}  // namespace lithe::hal::canopen
