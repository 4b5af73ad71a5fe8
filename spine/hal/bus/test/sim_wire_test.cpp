// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/bus/loop/sim_wire.hpp"

#include <gtest/gtest.h>

#include <bit>

namespace lithe::hal::sim {
namespace {

// Sends every frame back, and counts.
class Echo final : public BusNode {
 public:
  void on_frame(const Frame& frame, std::int64_t, FrameQueue& answers) LITHE_RT override {
    ++heard;
    last = frame;
    answers.push(frame);
  }
  int heard = 0;
  Frame last;
};

class Line {
 public:
  explicit Line(const WireFaults& faults) : wire(7) {
    wire.attach(echo);
    wire.set_faults(faults);
  }
  // How many of so many frames came back.
  int send(int count, std::int64_t now_ns = 0) {
    Frame frame;
    frame.size = 8;
    for (int i = 0; i < count; ++i) wire.on_frame(frame, now_ns, answers);
    return collect();
  }
  int collect() {
    int back = 0;
    for (; answers.front() != nullptr; answers.pop()) {
      for (const std::uint8_t byte : answers.front()->payload()) bits += std::popcount(byte);
      ++back;
    }
    return back;
  }
  SimWire wire;
  Echo echo;
  FrameQueue answers;
  int bits = 0;  // that came back wrong
};

TEST(SimWire, AGoodWireCarriesAll) {
  Line line({});
  EXPECT_EQ(line.send(100), 100);
  EXPECT_EQ(line.bits, 0);
}

TEST(SimWire, ABadOneLosesBothWays) {
  Line line({.drop = 0.5});
  const int back = line.send(200);
  EXPECT_GT(line.echo.heard, 60);
  EXPECT_LT(line.echo.heard, 140);
  EXPECT_LT(back, line.echo.heard);
  EXPECT_GT(back, 20);
}

TEST(SimWire, CorruptsOneBitEachWay) {
  Line line({.corrupt = 1});
  EXPECT_EQ(line.send(100), 100);
  EXPECT_GT(line.bits, 150);  // now and then the second takes the first back
  EXPECT_LE(line.bits, 200);
}

TEST(SimWire, DoublesBothWays) {
  Line line({.duplicate = 1});
  EXPECT_EQ(line.send(10), 40);
  EXPECT_EQ(line.echo.heard, 20);
}

TEST(SimWire, DelaysInOrder) {
  Line line({.delay_ns = 100});
  EXPECT_EQ(line.send(2, 1000), 0);
  EXPECT_EQ(line.wire.next_due_ns(), 1100);
  line.wire.set_faults({});
  EXPECT_EQ(line.send(1, 1050), 0);  // not before those that were sent before it
  line.wire.on_time(1100, line.answers);
  EXPECT_EQ(line.collect(), 3);
}

TEST(SimWire, BusOffIsSilenceAndEnds) {
  Line line({.bus_off = true});
  EXPECT_EQ(line.send(5), 0);
  EXPECT_EQ(line.echo.heard, 0);
  line.wire.set_faults({});
  EXPECT_EQ(line.send(5), 5);
}

TEST(SimWire, WhatWasUnderWayIsLostWithTheBus) {
  Line line({.delay_ns = 1000});
  EXPECT_EQ(line.send(5), 0);
  line.wire.set_faults({.delay_ns = 1000, .bus_off = true});
  line.wire.on_time(2000, line.answers);
  EXPECT_EQ(line.collect(), 0);
  line.wire.set_faults({});
  line.wire.on_time(3000, line.answers);
  EXPECT_EQ(line.collect(), 0);
}

}  // namespace
}  // namespace lithe::hal::sim
