// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/bus/fdcanusb/fdcanusb_bus.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <string>
#include <string_view>
#include <utility>

#include "spine/hal/bus/fdcanusb/fdcanusb_codec.hpp"
#include "spine/hal/bus/test/pty_rig.hpp"
#include "spine/hal/bus/test/sys_rig.hpp"

namespace lithe::hal {
namespace {

using std::string_literals::operator""s;
using test::TestPty;

Frame query() {
  Frame frame = test::command(0x8001, 6);
  frame.extended = frame.fd = frame.brs = true;
  return frame;
}

std::string summed(std::string text) {
  std::array<char, 256> out{};
  std::copy(text.begin(), text.end(), out.begin());
  return {out.data(), fdcanusb::append_sum(out, text.size())};
}

class FdcanusbBusTest : public ::testing::Test {
 protected:
  void open(Checksums checksums) {
    auto opened = FdcanusbBus::open({.path = pty.path(), .checksums = checksums, .sys = sys.path()});
    ASSERT_TRUE(opened) << opened.message();
    bus = std::move(*opened);
    greeting = pty.heard_until("\n");
    while (greeting.find("conf") == std::string::npos) greeting += pty.heard_until("\n");
  }
  std::string said() {
    EXPECT_TRUE(bus->send(query()));
    bus->flush();
    return pty.heard_until("\n");
  }
  bool next() { return test::next(*bus, frame); }
  // Everything said so far has been read.
  void drain() {
    const std::uint64_t before = bus->acknowledged();
    pty.say("OK\r\n");
    ASSERT_TRUE(test::await([&] { return !bus->receive(frame) && bus->acknowledged() > before; }));
  }

  // One exchange in every millisecond of so many; how many commands and questions came through.
  std::pair<int, int> pass(std::int64_t ms) {
    std::string all;
    const std::uint64_t before = bus->statistics().sent;
    for (std::int64_t end_ns = now_ns + ms * kMs; now_ns < end_ns; now_ns += kMs) {
      bus->begin(now_ns);
      bus->send(query());
      bus->flush();
      while (bus->receive(frame)) {
      }
      all += pty.heard();
    }
    // Bytes still on their way would be counted by the next call; what came is compared with what was sent.
    test::await([&] {
      all += pty.heard();
      return static_cast<std::uint64_t>(std::count(all.begin(), all.end(), '\n')) == bus->statistics().sent - before;
    });
    const auto count = [&](std::string_view word) {
      int times = 0;
      for (std::size_t at = all.find(word); at != std::string::npos; at = all.find(word, at + 1)) ++times;
      return times;
    };
    return {count("can send"), count("can status")};
  }

  static constexpr std::int64_t kMs = 1'000'000;
  TestPty pty;
  test::FakeSys sys;
  std::unique_ptr<FdcanusbBus> bus;
  std::string greeting;
  std::int64_t now_ns = 7'000 * kMs;
  Frame frame;
  static constexpr std::string_view kReceived = "rcv 0100 0102 e B F r x00";
};

TEST_F(FdcanusbBusTest, CarriesFramesBothWays) {
  open(Checksums::off);
  EXPECT_EQ(said(), "can send 8001 010203040506 BF\n");
  pty.say("OK\r\n" + std::string(kReceived) + "\r\n");
  ASSERT_TRUE(next());
  EXPECT_EQ(frame.id, 0x100U);
  EXPECT_EQ(frame.size, 2);
  EXPECT_TRUE(frame.fd && frame.brs && !frame.extended);
  EXPECT_EQ(bus->acknowledged(), 1U);
}

TEST_F(FdcanusbBusTest, TellsTheAdapterToBeOnTheBusAndToComeBackAfterABusOff) {
  open(Checksums::automatic);
  EXPECT_EQ(greeting, "can on\nconf set can.autorecover 1\n");
  pty.say("ERR already in BusOn\r\nOK\r\n");
  drain();
  EXPECT_EQ(bus->statistics().errors, 0U) << "it was on before: nothing is wrong";
}

// Whatever a program before us has left half said: the first word of ours makes it no command.
TEST_F(FdcanusbBusTest, ItsFirstWordIsHarmlessBehindHalfACommand) {
  open(Checksums::automatic);
  const std::string first = greeting.substr(0, greeting.find('\n'));
  for (const std::string& said : {"can send 8001 01000a1122 BF"s, "can send 8001 0100 bf"s, "can ext 12345 AA"s}) {
    for (std::size_t cut = 1; cut <= said.size(); ++cut) {
      fdcanusb::Request request;
      const char* wrong = fdcanusb::parse_request(said.substr(0, cut) + first, {}, request);
      EXPECT_NE(wrong, nullptr) << said.substr(0, cut) + first;
    }
  }
}

TEST_F(FdcanusbBusTest, OnlyARealFdcanusbIsMetWithoutChecksums) {
  sys.plug(pty.path(), "0483", "5740", "A");
  open(Checksums::by_device);
  EXPECT_EQ(greeting.find('*'), std::string::npos);
  EXPECT_EQ(said().find('*'), std::string::npos);
  pty.say(summed(std::string(kReceived)) + "\r\n");
  ASSERT_TRUE(next());
  EXPECT_NE(said().find(" *"), std::string::npos) << "but one that gives them gets them";
  bus.reset();
  sys.plug(pty.path(), "1a86", "7523", "");  // a UART behind USB
  open(Checksums::by_device);
  EXPECT_NE(greeting.find(" *"), std::string::npos);
  EXPECT_NE(said().find(" BF *"), std::string::npos);
}

// It keeps what nobody acknowledges, and sends it, old as it is, when the drives have power again.
TEST_F(FdcanusbBusTest, IntoSilenceOnlyAFewCommandsAreSentAndAFrameEndsIt) {
  open(Checksums::off);
  EXPECT_EQ(pass(500).first, 500) << "half a second is no silence yet";
  const auto [commands, questions] = pass(3'000);
  EXPECT_EQ(commands, 5) << "one in 0.6 s";
  EXPECT_EQ(questions, 5);
  EXPECT_EQ(bus->reply_wait_ns(), 0) << "the last exchange was mute: no answer will come";
  EXPECT_GT(bus->statistics().refused, 2'900U);
  pty.say(std::string(kReceived) + "\r\n");
  ASSERT_TRUE(next());
  EXPECT_EQ(pass(100).first, 100);
  EXPECT_EQ(bus->why_down(), "");
}

TEST_F(FdcanusbBusTest, ABusOffIsAskedForNamedAndNothingIsSentUntilItIsOver) {
  open(Checksums::off);
  pass(700);
  pty.say("lec=5 dlec=0 err=1 warn=1 busoff=1 pexc=0 tdc=13\r\n");
  ASSERT_TRUE(test::await([&] { return !bus->receive(frame) && !bus->why_down().empty(); }));
  EXPECT_NE(bus->why_down().find("bus-off"), std::string::npos) << bus->why_down();
  EXPECT_EQ(bus->statistics().errors, 1U);
  const auto [commands, questions] = pass(2'400);
  EXPECT_EQ(commands, 0);
  EXPECT_EQ(questions, 4);
  pty.say("lec=0 dlec=0 err=0 warn=0 busoff=0 pexc=0 tdc=13\r\n");
  ASSERT_TRUE(test::await([&] { return !bus->receive(frame) && bus->why_down().empty(); }));
  EXPECT_EQ(pass(600).first, 1) << "still silent: one to see whether anybody is there";
}

TEST_F(FdcanusbBusTest, WithoutChecksumsAnswersMayHaveOneThatHolds) {
  open(Checksums::off);
  pty.say(std::string(kReceived) + " *00\r\n" + summed(std::string(kReceived)) + "\r\n");
  ASSERT_TRUE(next());
  EXPECT_EQ(bus->statistics().malformed, 1U);
  EXPECT_EQ(said().find('*'), std::string::npos);
}

TEST_F(FdcanusbBusTest, WithChecksumsEveryLineHasOneAndEveryAnswerNeedsOne) {
  open(Checksums::on);
  EXPECT_EQ(said(), summed("can send 8001 010203040506 BF") + "\n");
  pty.say(std::string(kReceived) + "\r\n" + summed(std::string(kReceived)) + "\r\n");
  ASSERT_TRUE(next());
  EXPECT_EQ(bus->statistics().malformed, 1U);
}

TEST_F(FdcanusbBusTest, AutomaticSendsThemOnceTheAdapterHas) {
  open(Checksums::automatic);
  EXPECT_EQ(said().find('*'), std::string::npos);
  pty.say("OK\r\n" + std::string(kReceived) + "\r\n");
  ASSERT_TRUE(next());
  EXPECT_EQ(said().find('*'), std::string::npos);
  pty.say(summed(std::string(kReceived)) + "\r\n");
  ASSERT_TRUE(next());
  EXPECT_NE(said().find(" *"), std::string::npos);
}

TEST_F(FdcanusbBusTest, AutomaticSendsThemOnceTheAdapterAsks) {
  open(Checksums::automatic);
  EXPECT_EQ(said().find('*'), std::string::npos);
  pty.say("ERR checksum\r\n");
  ASSERT_TRUE(test::await([&] { return !bus->receive(frame) && bus->statistics().errors == 1; }));
  EXPECT_NE(said().find(" *"), std::string::npos);
}

TEST_F(FdcanusbBusTest, AChecksumThatDoesNotHoldTurnsNothingOn) {
  open(Checksums::automatic);
  pty.say(std::string(kReceived) + " *00\r\n" + std::string(kReceived) + "\r\n");
  ASSERT_TRUE(next());
  EXPECT_EQ(said().find('*'), std::string::npos);
}

TEST_F(FdcanusbBusTest, ANewAdapterStartsAnew) {
  open(Checksums::automatic);
  pty.say(summed(std::string(kReceived)) + "\r\n");
  ASSERT_TRUE(next());
  pty.unplug();
  ASSERT_TRUE(test::await([&] { return !bus->receive(frame) && !bus->why_down().empty(); }));
  pty.plug_in();
  bus->service();
  bus->begin(0);
  EXPECT_EQ(said().find('*'), std::string::npos);
}

TEST_F(FdcanusbBusTest, RefusalsAndNonsenseAreCounted) {
  open(Checksums::off);
  pty.say("ERR bad id\r\nERR not in BusOn state\r\nrcv 0100 012 E B F r x00\r\nrcv\r\nwelcome\r\n");
  drain();
  EXPECT_EQ(bus->statistics().errors, 2U);
  EXPECT_EQ(bus->statistics().malformed, 1U) << "the frame with half a byte; of the others nobody waits for anything";
  EXPECT_EQ(bus->statistics().received, 0U);
}

}  // namespace
}  // namespace lithe::hal
