// SPDX-License-Identifier: Apache-2.0
// What a host sees of the adapter; and our own host's end against it, over a real terminal.
#include "spine/hal/bus/slcan/sim_slcan.hpp"
#include "spine/core/test/units_rig.hpp"

#include <gtest/gtest.h>

#include <random>
#include <string>

#include "spine/hal/bus/slcan/slcan_bus.hpp"
#include "spine/hal/bus/test/pty_rig.hpp"

namespace lithe::hal::sim {
namespace {

// Answers every frame with the same one, its id one higher; says by itself what it is told to.
class Echo final : public BusNode {
 public:
  void on_frame(const Frame& frame, std::int64_t /*now_ns*/, FrameQueue& answers) LITHE_RT override {
    Frame answer = frame;
    ++answer.id;
    answers.push(answer);
    ++heard;
  }
  void on_time(std::int64_t /*now_ns*/, FrameQueue& answers) LITHE_RT override {
    if (beats) answers.push(beat);
  }
  int heard = 0;
  bool beats = false;
  Frame beat = test::command(0x701, 1);
};

class SimSlcanTest : public ::testing::Test {
 protected:
  SimSlcanTest() { adapter.attach(node); }
  std::string say(std::string_view text) {
    std::string out;
    adapter.feed({text.data(), text.size()}, now_ns, out);
    return out;
  }

  Echo node;
  SimSlcan adapter;
  std::int64_t now_ns = 1'234 * kMs;
};

// Whoever comes after a program that died in the middle of a line.
TEST_F(SimSlcanTest, TheFirstWordOfOurHostEndsNoHalfCommand) {
  test::TestPty pty;
  const auto bus = SlcanBus::open({pty.path()});
  ASSERT_TRUE(bus) << bus.message();
  const std::string greeting = pty.heard_until("O\r");
  for (const std::string half : {"t1012010", "t101201", "t10120", "t1012", "T0000010110", "r101"}) {
    say("C\rS8\rO\r");
    say(half);
    say(greeting);
    EXPECT_EQ(node.heard, 0) << half;
    EXPECT_TRUE(adapter.is_open());
  }
}

TEST_F(SimSlcanTest, ABusOffIsToldOnceAndEndsWithTheChannel) {
  say("S8\rO\r");
  adapter.set_bus_off(true);
  std::string out;
  adapter.idle(now_ns, out);
  adapter.idle(now_ns, out);
  EXPECT_EQ(out, "sb255000\r");
  EXPECT_EQ(say("t10021234\r"), "z\r");
  EXPECT_EQ(node.heard, 0);
  say("C\rO\r");
  adapter.idle(now_ns, out);
  EXPECT_EQ(out, "sb255000\rsb255000\r") << "the wires are as bad as before";
  adapter.set_bus_off(false);
  say("t10021234\r");
  EXPECT_EQ(node.heard, 0) << "they are good, but it gave up";
  say("C\rO\r");
  EXPECT_EQ(say("t10021234\r"), "z\rt10121234\r");
}

TEST_F(SimSlcanTest, OpensWithABitRateAndCarriesFrames) {
  EXPECT_EQ(say("C\r"), "\a") << "it is closed";
  EXPECT_EQ(say("O\r"), "\a") << "it knows no bit rate";
  EXPECT_EQ(say("S8\rO\r"), "\r\r");
  EXPECT_EQ(say("t10021234\r"), "z\rt10121234\r");
  EXPECT_EQ(say("T000001001AB\r"), "Z\rT000001011AB\r");
  EXPECT_EQ(say("r1000\r"), "z\r");
  EXPECT_EQ(say("O\r"), "\a");
  EXPECT_EQ(say("S6\r"), "\a") << "not while it is open";
  EXPECT_EQ(say("C\r"), "\r");
  EXPECT_EQ(say("t10021234\r"), "\a");
  EXPECT_EQ(node.heard, 2);
}

TEST_F(SimSlcanTest, WhatSlcandSaysOpensIt) { EXPECT_EQ(say("C\rS8\rF\rO\r"), "\a\r\a\r"); }

TEST_F(SimSlcanTest, FdPassesWithADataBitRateOnly) {
  say("S8\rO\r");
  EXPECT_EQ(say("b10081122334455667788\r"), "\a");
  node.beats = true;
  node.beat.fd = true;
  std::string out;
  adapter.idle(now_ns, out);
  EXPECT_EQ(out, "") << "no FD frame can come from a classic bus";
  EXPECT_EQ(say("C\rY5\rO\r"), "\r\r\r");
  EXPECT_EQ(say("b1009112233445566778899AABBCC\r"), "z\rb1019112233445566778899AABBCC\r");
  EXPECT_EQ(say("D00000100111\r"), "Z\rD00000101111\r");
}

TEST_F(SimSlcanTest, AListenerHearsAndSendsNothing) {
  EXPECT_EQ(say("S8\rL\r"), "\r\r");
  EXPECT_EQ(say("t1000\r"), "\a");
  node.beats = true;
  std::string out;
  adapter.idle(now_ns, out);
  EXPECT_EQ(out, "t701101\r");
}

TEST_F(SimSlcanTest, DevicesThatSpeakByThemselvesAreHeardWhileItIsOpen) {
  node.beats = true;
  std::string out;
  adapter.idle(now_ns, out);
  EXPECT_EQ(out, "");
  say("S8\rO\r");
  adapter.idle(now_ns, out);
  EXPECT_EQ(out, "t701101\r");
}

TEST_F(SimSlcanTest, TimeStampsAreMillisecondsOfTheMinute) {
  EXPECT_EQ(say("S8\rZ1\rO\rt1000\r"), "\r\r\rz\rt101004D2\r");
  now_ns = 60'001 * kMs;
  EXPECT_EQ(say("t1000\r"), "z\rt10100001\r");
  EXPECT_EQ(say("C\rZ0\rO\rt1000\r"), "\r\r\rz\rt1010\r");
}

TEST_F(SimSlcanTest, QuestionsAreAnswered) {
  EXPECT_EQ(say("V\rN\r"), "V1013\rNLTHE\r");
  EXPECT_EQ(say("F\r"), "\a");
  EXPECT_EQ(say("S8\rO\rF\r"), "\r\rF00\r");
}

TEST_F(SimSlcanTest, NonsenseIsRefusedAndHarmless) {
  say("S8\rO\r");
  for (const std::string& line : {std::string(), std::string("t100"), std::string("t1002123"), std::string("x"),
                                  std::string("t10021234567"), std::string(100'000, 't'), std::string(3, '\0')}) {
    EXPECT_EQ(say(line + "\r"), "\a") << line.substr(0, 20);
  }
  std::mt19937 random(9);
  for (int i = 0; i < 20'000; ++i) {
    std::string line(random() % 30, ' ');
    for (char& c : line) c = "tTrRdDbBSYZVNF0123456789ABCDEF\r\xff"[random() % 32];
    say(line);
  }
  say("\r");
  node.heard = 0;
  say("C\rS8\rO\r");
  EXPECT_TRUE(say("t1000\r").ends_with("t1010\r"));
  EXPECT_EQ(node.heard, 1);
}

TEST_F(SimSlcanTest, AfterPowerCameBackItIsClosedAndKnowsNothing) {
  say("S8\rY5\rZ1\rO\rt10");
  adapter.reset();
  EXPECT_FALSE(adapter.is_open());
  EXPECT_EQ(say("O\r"), "\a");
  EXPECT_EQ(say("S8\rO\rt1000\r"), "\r\rz\rt1010\r");
}

// Our own end of the line against it, whatever its manners.
class WithOurOwnBus : public ::testing::TestWithParam<SlcanManners> {};

TEST_P(WithOurOwnBus, FramesGoThereAndComeBack) {
  test::TestPty pty;
  Echo node;
  SimSlcan adapter(GetParam());
  adapter.attach(node);
  auto bus = SlcanBus::open({pty.path(), 1'000'000, 5'000'000});
  ASSERT_TRUE(bus) << bus.message();
  std::mt19937 random(1);
  for (int exchange = 0; exchange < 50; ++exchange) {
    (*bus)->begin(exchange);
    for (std::uint32_t id = 0; id < 12; ++id) {
      Frame frame = test::command(0x100 + 2 * id, static_cast<std::uint8_t>(fd_size(random() % 65)));
      frame.fd = frame.brs = true;
      ASSERT_TRUE((*bus)->send(frame));
    }
    (*bus)->flush();
    std::uint32_t answers = 0;
    ASSERT_TRUE(test::await([&] {
      const std::string heard = pty.heard();
      std::string said;
      adapter.feed({heard.data(), heard.size()}, exchange * kMs, said);
      pty.say(said);
      for (Frame frame; (*bus)->receive(frame); ++answers) EXPECT_EQ(frame.id, 0x101 + 2 * answers);
      return answers == 12;
    }));
  }
  EXPECT_EQ((*bus)->statistics().malformed, 0U);
  EXPECT_EQ((*bus)->statistics().errors, GetParam() == SlcanManners::lawicel ? 1U : 0U) << "it was closed already";
  EXPECT_EQ((*bus)->acknowledged(), GetParam() == SlcanManners::lawicel ? 600U + 3U : 0U);
}

INSTANTIATE_TEST_SUITE_P(Manners, WithOurOwnBus, ::testing::Values(SlcanManners::lawicel, SlcanManners::silent),
                         [](const auto& each) { return each.param == SlcanManners::lawicel ? "Lawicel" : "Silent"; });

}  // namespace
}  // namespace lithe::hal::sim
