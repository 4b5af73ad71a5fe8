// SPDX-License-Identifier: Apache-2.0
// A gateway's frames, as the simulated one sends them and as the driver reads them.
#include "spine/hal/gateway/sim/sim_gateway.hpp"
#include "spine/core/test/units_rig.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <memory>
#include <random>

namespace lithe::hal::sim {
namespace {

using gateway::Block;
using gateway::Gateway;

constexpr std::int64_t kStale = 50 * kMs;

// One second of the gateway's life, a look per millisecond; what came last is read by `reader`.
struct Second {
  explicit Second(bool fd) : sim(7, kMs, fd) {}
  void run(int ms = 1000) {
    for (int i = 0; i < ms; ++i) {
      now_ns += kMs;
      queue->clear();
      sim.on_time(now_ns, *queue);
      for (; const Frame* frame = queue->front(); queue->pop()) {
        EXPECT_TRUE(gateway::is_gateway(*frame));
        EXPECT_EQ(gateway::node_of(*frame), 7U);
        EXPECT_LE(frame->size, sim_fd ? 64 : 8);
        last = *frame;
        reader.on_frame(*frame, now_ns);
      }
    }
  }
  bool sim_fd = true;
  SimGateway sim;
  Gateway reader{7, kStale};
  std::unique_ptr<FrameQueue> queue = std::make_unique<FrameQueue>();
  std::int64_t now_ns = 5'000 * kMs;
  Frame last;
};

TEST(SimGateway, EveryChannelArrivesOnEitherKindOfBus) {
  for (const bool fd : {true, false}) {
    Second second(fd);
    second.sim_fd = fd;
    second.run();
    double raw = 0;
    for (std::size_t c = 0; c < gateway::kChannels; ++c) {
      ASSERT_TRUE(second.reader.read(Block::analog, c, second.now_ns, raw)) << fd << c;
      EXPECT_LE(std::abs(raw), 1000);
      ASSERT_TRUE(second.reader.read(Block::digital, c, second.now_ns, raw)) << fd << c;
      EXPECT_TRUE(raw == 0 || raw == 1);
      EXPECT_EQ(second.reader.read(Block::imu, c, second.now_ns, raw), c < 10) << fd << c;
    }
    ASSERT_TRUE(second.reader.read(Block::imu, 9, second.now_ns, raw));
    EXPECT_EQ(raw, 981);
    EXPECT_EQ(second.reader.counters().frames, 1000U);
    EXPECT_EQ(second.reader.counters().lost + second.reader.counters().malformed, 0U);
  }
}

TEST(SimGateway, ASilentGatewayAndAnUnpluggedInputAreNotValid) {
  Second second(true);
  second.sim.unplug_input(Block::analog, 3);
  second.sim.unplug_input(Block::digital, 0);
  second.run();
  double raw = -7;
  EXPECT_FALSE(second.reader.read(Block::analog, 3, second.now_ns, raw));
  EXPECT_FALSE(second.reader.read(Block::digital, 0, second.now_ns, raw));
  EXPECT_FALSE(second.reader.read(Block::analog, 16, second.now_ns, raw));
  EXPECT_EQ(raw, -7) << "unchanged";
  EXPECT_TRUE(second.reader.read(Block::analog, 4, second.now_ns, raw));
  EXPECT_TRUE(second.reader.read(Block::analog, 4, second.now_ns + kStale - 3 * kMs, raw));
  EXPECT_FALSE(second.reader.read(Block::analog, 4, second.now_ns + kStale + kMs, raw));
}

TEST(Gateway, LostRepeatedAndReorderedFramesAreCountedAndOldOnesNotUsed) {
  Second second(true);
  second.run(3);
  const Frame old = second.last;
  Frame next = old;
  next.data[0] = static_cast<std::uint8_t>(old.data[0] + 4);
  second.reader.on_frame(next, second.now_ns);
  EXPECT_EQ(second.reader.counters().lost, 3U);
  second.reader.on_frame(next, second.now_ns);
  second.reader.on_frame(old, second.now_ns);
  EXPECT_EQ(second.reader.counters().repeated, 2U);
  EXPECT_EQ(second.reader.counters().frames, 4U);
}

TEST(SimGateway, AMomentBringsOneFrameWhateverHappenedInIt) {
  Second second(true);
  second.run(3);
  second.now_ns += 100 * kMs;
  second.queue->clear();
  for (int i = 0; i < 5; ++i) second.sim.on_frame({}, second.now_ns, *second.queue);
  EXPECT_EQ(second.queue->size(), 1U);
}

// An analog value of 7 on every channel, of this sequence number and sampled then.
Frame words(std::uint8_t sequence, std::int64_t sampled_ns) {
  Frame frame;
  frame.id = gateway::kIdBase | 7U << 8;
  frame.extended = true;
  frame.size = 8;
  frame.data[0] = sequence;
  const auto stamp = static_cast<std::uint16_t>(sampled_ns / 100'000);
  frame.data[2] = static_cast<std::uint8_t>(stamp);
  frame.data[3] = static_cast<std::uint8_t>(stamp >> 8);
  frame.data[4] = frame.data[6] = 7;
  return frame;
}

bool valid(const Gateway& reader, std::int64_t now_ns) {
  double raw = 0;
  return reader.read(Block::analog, 0, now_ns, raw);
}

TEST(Gateway, AfterASilenceAnySequenceIsNew) {
  Gateway reader(7, kStale);
  reader.on_frame(words(200, 0), kMs);
  for (int i = 0; i < 20; ++i) reader.on_frame(words(static_cast<std::uint8_t>(120 + i), i * kMs), (1000 + i) * kMs);
  EXPECT_EQ(reader.counters().repeated, 0U);
  EXPECT_TRUE(valid(reader, 1019 * kMs));
}

TEST(Gateway, ASamplerThatHangsIsNotValidThoughFramesCome) {
  Gateway reader(7, kStale);
  std::uint8_t sequence = 0;
  for (int i = 0; i < 100; ++i) reader.on_frame(words(++sequence, i * kMs), i * kMs);
  EXPECT_TRUE(valid(reader, 99 * kMs));
  for (int i = 100; i < 140; ++i) reader.on_frame(words(++sequence, 100 * kMs), i * kMs);
  EXPECT_TRUE(valid(reader, 139 * kMs)) << "40 of 50 ms old";
  for (int i = 140; i < 200; ++i) reader.on_frame(words(++sequence, 100 * kMs), i * kMs);
  EXPECT_FALSE(valid(reader, 199 * kMs));
}

TEST(Gateway, ValuesThatWaitedInAQueueAreAsOldAsTheyAre) {
  Gateway reader(7, kStale);
  std::uint8_t sequence = 0;
  for (int i = 0; i < 100; ++i) reader.on_frame(words(++sequence, i * kMs), (i + 1) * kMs);
  for (int i = 100; i < 400; ++i)
    reader.on_frame(words(++sequence, (i - i / 4) * kMs), (i + 1) * kMs);  // more and more
  EXPECT_FALSE(valid(reader, 400 * kMs));
  for (int i = 400; i < 500; ++i) reader.on_frame(words(++sequence, i * kMs), (i + 1) * kMs);  // emptied
  EXPECT_TRUE(valid(reader, 500 * kMs));
}

// For an hour, 100 millionths fast and 100 slow; its stamp wraps every 6.5 s.
TEST(Gateway, AClockThatDriftsIsNoAge) {
  for (const double drift : {1e-4, -1e-4}) {
    Gateway reader(7, kStale);
    std::uint8_t sequence = 0;
    for (std::int64_t ms = 0; ms < 3'600'000; ms += 20) {
      reader.on_frame(words(++sequence, static_cast<std::int64_t>((1 + drift) * static_cast<double>(ms * kMs))),
                      ms * kMs);
      ASSERT_TRUE(valid(reader, ms * kMs)) << ms;
    }
  }
}

TEST(Gateway, NonsenseIsCountedAndChangesNothing) {
  std::mt19937 random(4);
  Gateway reader(7, kStale);
  double raw = -7;
  for (int i = 0; i < 100'000; ++i) {
    Frame frame;
    frame.extended = true;
    frame.id = gateway::kIdBase | 7U << 8 | static_cast<std::uint32_t>(random() % 6);
    frame.size = static_cast<std::uint8_t>(random());
    for (std::uint8_t& byte : frame.data) byte = static_cast<std::uint8_t>(random());
    reader.on_frame(frame, i);
    for (std::size_t c = 0; c < 18; ++c) {
      if (!reader.read(static_cast<Block>(random() % 3), c, i, raw)) continue;
      ASSERT_LE(std::abs(raw), 32767);
    }
  }
  EXPECT_GT(reader.counters().malformed, 10'000U);
  EXPECT_GT(reader.counters().frames, 500U);
  Gateway fresh(7, kStale);
  Frame foreign;
  foreign.id = 0x8001;
  EXPECT_FALSE(gateway::is_gateway(foreign));
}

}  // namespace
}  // namespace lithe::hal::sim
