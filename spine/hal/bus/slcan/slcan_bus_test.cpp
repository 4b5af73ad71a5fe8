// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/bus/slcan/slcan_bus.hpp"

#include <gtest/gtest.h>

#include "spine/hal/bus/test/pty_rig.hpp"

namespace lithe::hal {
namespace {

using test::command;
using test::TestPty;

TEST(SlcanBus, TellsTheAdapterItsBitRates) {
  TestPty pty;
  {
    const auto classic = SlcanBus::open({pty.path(), 250'000, 0, 0});
    ASSERT_TRUE(classic) << classic.message();
    EXPECT_EQ(pty.heard_until("O\r"), "V\rC\rS5\rO\r");
  }
  EXPECT_EQ(pty.heard_until("C\r"), "C\r");
  const auto fd = SlcanBus::open({pty.path(), 1'000'000, 5'000'000, 0});
  ASSERT_TRUE(fd) << fd.message();
  EXPECT_EQ(pty.heard_until("O\r"), "V\rC\rS8\rY5\rO\r");
}

TEST(SlcanBus, RefusesWhatNoAdapterCan) {
  TestPty pty;
  for (const SlcanParams& params : {SlcanParams{pty.path(), 333'333}, SlcanParams{pty.path(), 1'000'000, 8'000'000},
                                    SlcanParams{"/no/such/device"}}) {
    const auto opened = SlcanBus::open(params);
    ASSERT_FALSE(opened);
    EXPECT_TRUE(opened.message().starts_with(params.path)) << opened.message();
    EXPECT_NE(opened.message().find("; "), std::string::npos) << "and what to do next: " << opened.message();
  }
}

TEST(SlcanBus, CarriesFdOnlyWhenItWasAskedTo) {
  TestPty pty;
  Frame fd = command(0x101, 12);
  fd.fd = fd.brs = true;
  {
    const auto classic = SlcanBus::open({pty.path()});
    ASSERT_TRUE(classic);
    EXPECT_FALSE((*classic)->send(fd));
    EXPECT_EQ((*classic)->statistics().refused, 1U);
    pty.heard_until("O\r");
  }
  pty.heard_until("C\r");
  const auto bus = SlcanBus::open({pty.path(), 1'000'000, 2'000'000});
  ASSERT_TRUE(bus);
  pty.heard_until("O\r");
  EXPECT_TRUE((*bus)->send(fd));
  (*bus)->flush();
  EXPECT_EQ(pty.heard_until("\r"), "b10190102030405060708090A0B0C\r");
  pty.say("D000080019000102030405060708090A0B\r");
  Frame frame;
  ASSERT_TRUE(test::next(**bus, frame));
  EXPECT_TRUE(frame.fd && frame.extended && !frame.brs);
  EXPECT_EQ(frame.id, 0x8001U);
  EXPECT_EQ(frame.size, 12);
}

TEST(SlcanBus, WaitsForAnswersAsLongAsItIsTold) {
  TestPty pty;
  const auto bus = SlcanBus::open({pty.path(), 1'000'000, 0, 3'000'000});
  ASSERT_TRUE(bus);
  EXPECT_EQ((*bus)->reply_wait_ns(), 3'000'000);
}

TEST(SlcanBus, CountsErrorsThatTheAdapterReports) {
  TestPty pty;
  const auto bus = SlcanBus::open({pty.path()});
  ASSERT_TRUE(bus);
  pty.say("\asp128000\re1a\rsa000000\rV1013\rr1238\rt1230\r");
  Frame frame;
  ASSERT_TRUE(test::next(**bus, frame));
  EXPECT_EQ((*bus)->statistics().errors, 3U);
  EXPECT_EQ((*bus)->statistics().malformed, 0U);
}

TEST(SlcanBus, ABusOffIsNamedAndTheChannelIsOpenedAnew) {
  TestPty pty;
  const auto bus = SlcanBus::open({pty.path()});
  ASSERT_TRUE(bus);
  pty.heard_until("O\r");
  pty.say("sb255000\rt1230\r");
  Frame frame;
  ASSERT_TRUE(test::await([&] { return !(*bus)->receive(frame) && !(*bus)->why_down().empty(); }));
  EXPECT_NE((*bus)->why_down().find("bus-off"), std::string::npos) << (*bus)->why_down();
  EXPECT_EQ((*bus)->statistics().errors, 1U);
  EXPECT_FALSE((*bus)->send(command(1, 1))) << "it would wait, and leave when nobody wants it any more";
  (*bus)->service();
  EXPECT_EQ(pty.heard_until("O\r"), "V\rC\rS8\rO\r");
  EXPECT_EQ((*bus)->why_down(), "");
  (*bus)->begin(0);
  EXPECT_TRUE((*bus)->send(command(1, 1)));
  EXPECT_EQ((*bus)->statistics().reopened, 1U);
}

}  // namespace
}  // namespace lithe::hal
