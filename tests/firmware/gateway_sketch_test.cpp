// SPDX-License-Identifier: Apache-2.0
// The reference sketch of the gateway, against a stub of its CAN library: the driver reads all that it sends.
#include <gtest/gtest.h>

#include <algorithm>

#include "spine/hal/gateway/gateway.hpp"
using std::uint16_t, std::uint32_t, std::uint8_t, std::int16_t, std::int32_t;  // as an Arduino has them
#include "firmware/teensy_gateway/teensy_gateway.ino"

namespace lithe::hal::gateway {
namespace {

template <class Message>
Frame frame_of(const Message& message, bool fd) {
  Frame frame;
  frame.id = message.id;
  frame.extended = message.flags.extended;
  frame.fd = frame.brs = fd;
  frame.size = message.len;
  std::copy_n(message.buf, message.len, frame.data.begin());
  return frame;
}

class Sketch : public testing::Test {
 protected:
  Sketch() {
    for (std::size_t c = 0; c < gateway::kChannels; ++c) {
      g_stub_analog[kAnalogPins[c]] = 100 + static_cast<int>(c);
      g_stub_digital[kDigitalPins[c]] = c % 3 == 0;
    }
    g_stub_analog[kAnalogPins[5]] = 4095;  // a broken wire
    g_stub_fd.clear();
    g_stub_classic.clear();
    g_stub_micros = 300'000;  // a Teensy takes its time before setup()
    setup();
  }
  void expect_all(const Gateway& gateway) {
    double raw = 0;
    for (std::size_t c = 0; c < gateway::kChannels; ++c) {
      EXPECT_EQ(gateway.read(Block::analog, c, 1, raw), c != 5) << c;
      EXPECT_TRUE(c == 5 || raw == 100.0 + static_cast<double>(c)) << raw;
      ASSERT_TRUE(gateway.read(Block::digital, c, 1, raw)) << c;
      EXPECT_EQ(raw, c % 3 == 0 ? 1 : 0) << c;
    }
    EXPECT_EQ(gateway.counters().malformed + gateway.counters().lost + gateway.counters().repeated, 0U);
  }
};

// Pins of CAN1 and CAN3 on a Teensy 4.1, transmitter and receiver.
constexpr bool is_can(uint8_t pin) { return pin == 22 || pin == 23 || pin == 30 || pin == 31; }

TEST_F(Sketch, NoInputIsAPinOfItsBus) {
  for (const uint8_t pin : kAnalogPins) EXPECT_FALSE(is_can(pin)) << int{pin};
  for (const uint8_t pin : kDigitalPins) EXPECT_FALSE(is_can(pin)) << int{pin};
}

TEST_F(Sketch, NothingIsMadeUpForTheTimeBeforeItStarted) {
  EXPECT_TRUE(g_stub_fd.empty());
  for (int i = 0; i < 10; ++i) loop();
  EXPECT_LE(g_stub_fd.size(), 2U);
  g_stub_micros += 1'000'000;  // it was busy with something else
  for (int i = 0; i < 10; ++i) loop();
  EXPECT_LE(g_stub_fd.size(), 4U);
}

TEST_F(Sketch, ItsFdFramesHoldEveryChannel) {
  Gateway gateway(kNode, 1'000'000);
  const std::uint32_t from_us = g_stub_micros;
  for (; g_stub_micros < from_us + 10'000; g_stub_micros += 50) loop();
  ASSERT_GE(g_stub_fd.size(), 18U);
  EXPECT_LE(g_stub_fd.size(), 21U) << "one each half millisecond";
  for (const CANFD_message_t& message : g_stub_fd) {
    const Frame frame = frame_of(message, true);
    EXPECT_EQ(frame.size, fd_size(frame.size)) << "a length that CAN FD knows";
    ASSERT_TRUE(is_gateway(frame));
    EXPECT_TRUE(message.seq) << "frames may overtake each other";
    ASSERT_EQ(node_of(frame), kNode);
    gateway.on_frame(frame, 1);
  }
  expect_all(gateway);
}

TEST_F(Sketch, ItsClassicFramesDoToo) {
  Gateway gateway(kNode, 1'000'000);
  for (int i = 0; i < 18; ++i) send_classic();
  for (const CAN_message_t& message : g_stub_classic) {
    ASSERT_LE(message.len, 8);
    EXPECT_TRUE(message.seq);
    gateway.on_frame(frame_of(message, false), 1);
  }
  expect_all(gateway);
}

}  // namespace
}  // namespace lithe::hal::gateway
