// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/bus/fdcanusb_bus.hpp"

#include <gtest/gtest.h>

#include <string>

#include "spine/hal/bus/fdcanusb_codec.hpp"
#include "spine/hal/bus/test_pty.hpp"

namespace lithe::hal {
namespace {

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
    auto opened = FdcanusbBus::open({pty.path(), checksums});
    ASSERT_TRUE(opened) << opened.message();
    bus = std::move(*opened);
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

  TestPty pty;
  std::unique_ptr<FdcanusbBus> bus;
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

TEST_F(FdcanusbBusTest, SaysNothingWhenOpened) {
  open(Checksums::automatic);
  EXPECT_EQ(said().substr(0, 9), "can send ") << "half a command of a program before us is not to be ended";
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
  EXPECT_EQ(bus->statistics().malformed, 1U);
  EXPECT_EQ(bus->statistics().received, 0U);
}

}  // namespace
}  // namespace lithe::hal
