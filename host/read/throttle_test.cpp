// SPDX-License-Identifier: Apache-2.0
#include "host/read/throttle.hpp"

#include <gtest/gtest.h>

#include "host/test/root_rig.hpp"

namespace lithe::host {
namespace {

constexpr const char* kCount = "/sys/devices/system/cpu/cpu1/thermal_throttle/core_throttle_count";
constexpr const char* kFirmware = "/sys/devices/platform/soc/soc:firmware/get_throttled";

Throttle of(const FakeRoot& root) { return read_throttle(HostFiles(root.path())); }

TEST(Throttle, NothingIsKnownWhereNothingCanBeRead) {
  const FakeRoot root;
  EXPECT_EQ(of(root).sources, 0);
  root.write(kCount, "not a number\n");
  EXPECT_EQ(of(root).sources, 0);
}

TEST(Throttle, ACounterOfX86IsToldWhenItGrows) {
  const FakeRoot root;
  root.write("/sys/devices/system/cpu/cpu0/thermal_throttle/core_throttle_count", "0\n");
  root.write(kCount, "7\n");
  ThrottleWatch watch;
  EXPECT_EQ(watch.look(of(root)), "") << "those were before the first reading";
  EXPECT_FALSE(watch.active());
  root.write(kCount, "9\n");
  EXPECT_NE(watch.look(of(root)).find("cpu1 core_throttle_count 9"), std::string::npos);
  EXPECT_TRUE(watch.active());
  EXPECT_EQ(watch.look(of(root)), "the processor has its full speed again");
  EXPECT_EQ(watch.times(), 1u);
}

TEST(Throttle, TheFirmwareOfARaspberryPiIsReadBitByBit) {
  const FakeRoot root;
  root.write(kFirmware, "50000\n");  // since boot only
  EXPECT_EQ(of(root).sources, 1);
  EXPECT_FALSE(of(root).active);
  root.write(kFirmware, "0x50001\n");
  EXPECT_TRUE(of(root).active);
  EXPECT_EQ(of(root).why, "firmware: under-voltage");
}

TEST(Throttle, OnlyCoolingOfAProcessorCounts) {
  const FakeRoot root;
  root.write("/sys/class/thermal/cooling_device0/type", "pwm-fan\n");
  root.write("/sys/class/thermal/cooling_device0/cur_state", "3\n");
  EXPECT_EQ(of(root).sources, 0);
  root.write("/sys/class/thermal/cooling_device1/type", "thermal-cpufreq-0\n");
  root.write("/sys/class/thermal/cooling_device1/cur_state", "0\n");
  EXPECT_FALSE(of(root).active);
  root.write("/sys/class/thermal/cooling_device1/cur_state", "2\n");
  EXPECT_TRUE(of(root).active);
}

TEST(Throttle, WhatLastsIsToldOnce) {
  const FakeRoot root;
  root.write(kFirmware, "4");
  ThrottleWatch watch;
  EXPECT_NE(watch.look(of(root)), "") << "it lasts, so it is told also at the first reading";
  EXPECT_EQ(watch.look(of(root)), "");
  EXPECT_TRUE(watch.active());
  root.write(kFirmware, "40000");
  EXPECT_NE(watch.look(of(root)), "");
  EXPECT_FALSE(watch.active());
}

}  // namespace
}  // namespace lithe::host
