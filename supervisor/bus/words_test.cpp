// SPDX-License-Identifier: Apache-2.0
#include "supervisor/bus/words.hpp"

#include <gtest/gtest.h>

namespace lithe::bus {
namespace {

using robot::DeviceKind;

std::uint32_t said(std::uint32_t mode, std::uint32_t code) { return mode << 16 | code << 8 | 1; }

TEST(DriveWords, AMoteusHasAModeAndAFaultOrALimit) {
  EXPECT_EQ(drive_words(DeviceKind::moteus, said(10, 0)), "position");
  EXPECT_EQ(drive_words(DeviceKind::moteus, said(1, 38)), "fault: over-temperature (38)");
  EXPECT_EQ(drive_words(DeviceKind::moteus, said(10, 96)), "position, at its limit: velocity limit (96)");
  EXPECT_EQ(drive_words(DeviceKind::moteus, said(11, 0)), "timeout");
  EXPECT_EQ(drive_words(DeviceKind::moteus, said(200, 200)), "unknown: unknown (200)") << "whatever comes, words";
}

// The same numbers mean something else.
TEST(DriveWords, ACanopenDriveHasAStateAndTheClassOfItsEmergency) {
  EXPECT_EQ(drive_words(DeviceKind::cia402, said(4, 0)), "operation enabled");
  EXPECT_EQ(drive_words(DeviceKind::cia402, said(7, 0x42)), "fault: temperature (42xxh)");
  EXPECT_EQ(drive_words(DeviceKind::cia402, said(7, 0xff)), "fault: it does not say why");
  EXPECT_EQ(drive_words(DeviceKind::gateway, said(7, 0x42)), "");
}

}  // namespace
}  // namespace lithe::bus
