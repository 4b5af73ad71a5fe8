// SPDX-License-Identifier: Apache-2.0
#include "supervisor/bus/scan/place.hpp"

#include <gtest/gtest.h>

#include <unistd.h>

#include <filesystem>
#include <string>

namespace lithe::bus {
namespace {

using robot::BusKind;

const std::string kFrankenstein = LITHE_ROBOTS "/frankenstein.toml";

TEST(Place, ABusCanBeGivenWithoutAFile) {
  const auto usb = choose({.what = "fdcanusb:/dev/ttyACM0"});
  ASSERT_TRUE(usb);
  EXPECT_FALSE(usb->from_file);
  EXPECT_EQ(usb->robot.buses.at(0).kind, BusKind::fdcanusb);
  EXPECT_EQ(usb->robot.buses.at(0).path, "/dev/ttyACM0");
  EXPECT_EQ(place_of(usb->robot.buses.at(0)), "fdcanusb:/dev/ttyACM0");
  EXPECT_EQ(choose({.what = "slcan:/dev/ttyACM1"})->robot.buses.at(0).data_bitrate, 0U);
  EXPECT_EQ(choose({.what = "socketcan:can0", .data_bitrate = 0})->robot.buses.at(0).data_bitrate, 0U);
  EXPECT_EQ(choose({.what = "socketcan:can0"})->robot.buses.at(0).interface, "can0");
  EXPECT_EQ(choose({.what = "pi3hat:5"})->robot.buses.at(0).connector, 5U);
}

TEST(Place, WhatCannotBeIsRefusedWithWhatCan) {
  EXPECT_NE(choose({.what = "pi3hat:6"}).message().find("1 to 5"), std::string::npos);
  EXPECT_NE(choose({.what = "canbus:can0"}).message().find("socketcan:NAME"), std::string::npos);
  EXPECT_NE(choose({.what = kFrankenstein, .bus = "can9"}).message().find("it has can0, can1, can2"),
            std::string::npos);
  EXPECT_FALSE(choose({.what = kFrankenstein, .bitrate = 500'000}));
  EXPECT_FALSE(choose({.what = "socketcan:can0", .bus = "can0"}));
}

// A rate of 0 is divided by, in the monitor and in a pi3hat.
TEST(Place, BitRatesThatNoBusHasAreRefused) {
  for (const std::uint32_t rate : {0U, 9'999U, 1'000'001U}) {
    const auto refused = choose({.what = "socketcan:can0", .bitrate = rate});
    ASSERT_FALSE(refused) << rate;
    EXPECT_NE(refused.message().find("10000 to 1000000"), std::string::npos) << refused.message();
  }
  EXPECT_FALSE(choose({.what = "socketcan:can0", .bitrate = 500'000, .data_bitrate = 499'999}));
  EXPECT_FALSE(choose({.what = "socketcan:can0", .data_bitrate = 8'000'001}));
  EXPECT_TRUE(choose({.what = "socketcan:can0", .bitrate = 10'000, .data_bitrate = 0}));
  EXPECT_TRUE(choose({.what = "socketcan:can0", .bitrate = 1'000'000, .data_bitrate = 8'000'000}));
  EXPECT_TRUE(choose({.what = "slcan:/dev/ttyACM1", .bitrate = 50'000})) << "classic unless it is told otherwise";
}

TEST(Place, OfAFileAllBusesOrOne) {
  EXPECT_EQ(choose({.what = kFrankenstein})->buses.size(), 3U);
  const auto one = choose({.what = kFrankenstein, .bus = "can1"});
  ASSERT_TRUE(one);
  EXPECT_EQ(one->buses, std::vector<std::size_t>{1});
  EXPECT_TRUE(one->from_file);
}

TEST(Place, OneDeviceUnderTwoNamesIsOne) {
  const std::string folder = testing::TempDir() + "place" + std::to_string(getpid());
  std::filesystem::create_directories(folder);
  std::filesystem::create_symlink("/dev/null", folder + "/arm");
  const auto bus = [](const std::string& what) { return choose({.what = what})->robot.buses.at(0); };
  EXPECT_TRUE(same_hardware(bus("fdcanusb:" + folder + "/arm"), bus("slcan:/dev/null")));
  EXPECT_FALSE(same_hardware(bus("fdcanusb:/dev/zero"), bus("fdcanusb:/dev/null")));
  EXPECT_TRUE(same_hardware(bus("socketcan:can0"), bus("socketcan:can0")));
  EXPECT_FALSE(same_hardware(bus("socketcan:can0"), bus("socketcan:can1")));
  EXPECT_TRUE(same_hardware(bus("pi3hat:1"), bus("pi3hat:2")));
  EXPECT_FALSE(same_hardware(robot::BusConfig{}, robot::BusConfig{}));
  std::filesystem::remove_all(folder);
}

}  // namespace
}  // namespace lithe::bus
