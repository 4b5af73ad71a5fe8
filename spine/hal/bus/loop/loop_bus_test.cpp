// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/bus/loop/loop_bus.hpp"

#include <gtest/gtest.h>

namespace lithe::hal {
namespace {

// Sends every frame back with bit 28 of its id set, and keeps the time it was told.
class Echo final : public BusNode {
 public:
  void on_frame(const Frame& frame, std::int64_t now_ns, FrameQueue& answers) LITHE_RT override {
    Frame answer = frame;
    answer.id |= 1U << 28;
    answers.push(answer);
    last_ns = now_ns;
  }
  std::int64_t last_ns = 0;
};

// Says something by itself each time it is told the time.
class Clock final : public BusNode {
 public:
  void on_frame(const Frame&, std::int64_t, FrameQueue&) LITHE_RT override {}
  void on_time(std::int64_t now_ns, FrameQueue& answers) LITHE_RT override {
    Frame tick;
    tick.id = static_cast<std::uint32_t>(now_ns);
    answers.push(tick);
  }
};

Frame frame_with_id(std::uint32_t id) {
  Frame frame;
  frame.id = id;
  frame.size = 4;
  frame.data[3] = static_cast<std::uint8_t>(id);
  return frame;
}

TEST(LoopBus, WhatANodeSaysByItselfArrivesInTheExchangeThatItWasSaidIn) {
  LoopBus bus;
  Clock clock;
  bus.attach(clock);
  bus.begin(7);
  Frame frame;
  ASSERT_TRUE(bus.receive(frame));
  EXPECT_EQ(frame.id, 7U);
  EXPECT_FALSE(bus.receive(frame));
}

TEST(LoopBus, FramesComeBackWholeAndInOrder) {
  LoopBus bus;
  Echo echo;
  bus.attach(echo);
  bus.begin(77);
  for (std::uint32_t id = 0; id < 100; ++id) ASSERT_TRUE(bus.send(frame_with_id(id)));
  Frame frame;
  for (std::uint32_t id = 0; id < 100; ++id) {
    ASSERT_TRUE(bus.receive(frame));
    EXPECT_EQ(frame.id, id | 1U << 28);
    EXPECT_EQ(frame.size, 4);
    EXPECT_EQ(frame.data[3], id);
  }
  EXPECT_FALSE(bus.receive(frame));
  EXPECT_EQ(echo.last_ns, 77);
  EXPECT_EQ(bus.statistics().sent, 100U);
  EXPECT_EQ(bus.statistics().received, 100U);
  EXPECT_EQ(bus.statistics().refused, 0U);
  EXPECT_EQ(bus.statistics().late, 0U);
}

TEST(LoopBus, AFullQueueRefusesAndCountsAndLosesNothingOfWhatItTook) {
  LoopBus bus;
  Echo echo;
  bus.attach(echo);
  bus.begin(0);
  for (std::uint32_t id = 0; id < FrameQueue::kCapacity; ++id) ASSERT_TRUE(bus.send(frame_with_id(id)));
  EXPECT_FALSE(bus.send(frame_with_id(9999)));
  EXPECT_EQ(bus.statistics().refused, 1U);
  Frame frame;
  for (std::uint32_t id = 0; id < FrameQueue::kCapacity; ++id) {
    ASSERT_TRUE(bus.receive(frame));
    EXPECT_EQ(frame.id, id | 1U << 28);
  }
  EXPECT_FALSE(bus.receive(frame));
}

TEST(LoopBus, AnswersThatFindNoRoomAreCountedAsWell) {
  LoopBus bus;
  Echo one, two;
  bus.attach(one);
  bus.attach(two);
  bus.begin(0);
  constexpr std::size_t kSent = 200;
  for (std::uint32_t id = 0; id < kSent; ++id) ASSERT_TRUE(bus.send(frame_with_id(id)));
  Frame frame;
  std::size_t answers = 0;
  while (bus.receive(frame)) ++answers;
  EXPECT_EQ(answers, FrameQueue::kCapacity);
  EXPECT_EQ(bus.statistics().refused, 2 * kSent - FrameQueue::kCapacity);
}

TEST(LoopBus, WhatIsNotCollectedInItsExchangeIsLateAndThrownAway) {
  LoopBus bus;
  Echo echo;
  bus.attach(echo);
  bus.begin(1);
  bus.send(frame_with_id(1));
  bus.send(frame_with_id(2));
  bus.begin(2);
  EXPECT_EQ(echo.last_ns, 1) << "an old frame belongs to the old exchange's time";
  Frame frame;
  EXPECT_FALSE(bus.receive(frame));
  EXPECT_EQ(bus.statistics().late, 2U);
}

TEST(LoopBus, EveryNodeSeesEveryFrame) {
  LoopBus bus;
  Echo one;
  Echo two;
  bus.attach(one);
  bus.attach(two);
  bus.begin(5);
  bus.send(frame_with_id(3));
  Frame frame;
  EXPECT_TRUE(bus.receive(frame));
  EXPECT_TRUE(bus.receive(frame));
  EXPECT_FALSE(bus.receive(frame));
}

TEST(Frame, LengthsAreThoseOfCanFd) {
  EXPECT_EQ(fd_size(0), 0U);
  EXPECT_EQ(fd_size(8), 8U);
  EXPECT_EQ(fd_size(9), 12U);
  EXPECT_EQ(fd_size(13), 16U);
  EXPECT_EQ(fd_size(17), 20U);
  EXPECT_EQ(fd_size(21), 24U);
  EXPECT_EQ(fd_size(25), 32U);
  EXPECT_EQ(fd_size(33), 48U);
  EXPECT_EQ(fd_size(49), 64U);
  EXPECT_EQ(fd_size(64), 64U);
}

TEST(Frame, APayloadNeverReachesBeyondTheData) {
  Frame frame;
  frame.size = 255;
  EXPECT_EQ(frame.payload().size(), kMaxPayload);
}

}  // namespace
}  // namespace lithe::hal
