// SPDX-License-Identifier: Apache-2.0
#include "spine/frames.hpp"

#include <gtest/gtest.h>

#include <chrono>
#include <memory>
#include <thread>

namespace lithe {
namespace {

class FrameRingTest : public ::testing::Test {
 protected:
  ipc::FrameRecord next() {
    ipc::FrameRecord record;
    EXPECT_TRUE(reader.next(record));
    return record;
  }
  void watch() {
    const std::int64_t until_ns = monotonic_ns() + 60 * kNsPerS;
    ipc::store_word(memory->wanted_until_ns.value, static_cast<std::uint64_t>(until_ns), std::memory_order_relaxed);
  }

  std::unique_ptr<ipc::FramesMemory> memory = std::make_unique<ipc::FramesMemory>();
  ipc::RingReader<ipc::FrameRecord, ipc::FramesMemory::kDepth> reader{memory->ring};
  FrameRing tap{*memory, robot::RobotConfig{}, RawClock::calibrate()};
};

TEST_F(FrameRingTest, NothingIsWantedWhileNobodyWatches) {
  EXPECT_FALSE(tap.wanted(monotonic_ns()));
  watch();
  EXPECT_TRUE(tap.wanted(monotonic_ns()));
}

TEST_F(FrameRingTest, TimesGoOnFromOneBusOfAnExchangeToTheNext) {
  watch();
  const std::int64_t now_ns = monotonic_ns();
  ASSERT_TRUE(tap.wanted(now_ns));
  std::this_thread::sleep_for(std::chrono::milliseconds(2));
  tap.saw(0, true, hal::Frame{});
  ASSERT_TRUE(tap.wanted(now_ns)) << "the next bus begins";
  tap.saw(1, true, hal::Frame{});
  const ipc::FrameRecord first = next(), second = next();
  EXPECT_EQ(second.bus, 1);
  EXPECT_GE(first.time_ns, now_ns + 1'000'000);
  EXPECT_GE(second.time_ns, first.time_ns);
}

}  // namespace
}  // namespace lithe
