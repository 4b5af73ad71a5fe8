// SPDX-License-Identifier: Apache-2.0
// What all adapters that speak in lines have in common, shown with slcan.
#include "spine/hal/bus/serial/text_bus.hpp"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <termios.h>

#include <atomic>
#include <memory>
#include <thread>

#include "spine/core/test/no_alloc_rig.hpp"
#include "spine/hal/bus/slcan/slcan_bus.hpp"
#include "spine/hal/bus/slcan/slcan_codec.hpp"
#include "spine/hal/bus/test/pty_rig.hpp"

namespace lithe::hal {
namespace {

using test::command;
using test::TestPty;

constexpr std::string_view kGreeting = "V\rC\rS8\rO\r";

class TextBusTest : public ::testing::Test {
 protected:
  TextBusTest() {
    auto opened = SlcanBus::open({pty.path()});
    EXPECT_TRUE(opened) << (opened ? "" : opened.message());
    if (opened) bus = std::move(*opened);
    EXPECT_EQ(pty.heard_until("O\r"), kGreeting);
  }

  bool next() { return test::next(*bus, frame); }
  // Nothing more comes: the adapter says something that is no frame, and it has been read.
  bool drained() {
    const std::uint64_t before = bus->acknowledged();
    pty.say("\r");
    return test::await([&] { return !bus->receive(frame) && bus->acknowledged() > before; });
  }

  TestPty pty;
  std::unique_ptr<SlcanBus> bus;
  Frame frame;
};

TEST_F(TextBusTest, CommandsLeaveTogetherAndInOrder) {
  bus->begin(0);
  EXPECT_TRUE(bus->send(command(0x101, 2)));
  EXPECT_TRUE(bus->send(command(0x102, 0)));
  bus->flush();
  EXPECT_EQ(pty.heard_until("t1020\r"), "t10120102\rt1020\r");
  EXPECT_EQ(bus->statistics().sent, 2U);
}

TEST_F(TextBusTest, LinesArePutTogetherFromPiecesOfAnySize) {
  const std::string text = "t10120102\rz\rT12345678401020304\r\rt7FF0\r";
  for (std::size_t piece = 1; piece <= text.size(); ++piece) {
    for (std::size_t at = 0; at < text.size(); at += piece) {
      pty.say(std::string_view(text).substr(at, piece));
      if (piece < 4) std::this_thread::sleep_for(std::chrono::microseconds(50));
    }
    ASSERT_TRUE(next());
    EXPECT_EQ(frame.id, 0x101U);
    ASSERT_TRUE(next());
    EXPECT_EQ(frame.id, 0x12345678U);
    EXPECT_EQ(frame.data[3], 4);
    ASSERT_TRUE(next());
    EXPECT_EQ(frame.id, 0x7ffU);
  }
  EXPECT_EQ(bus->statistics().received, 3 * text.size());
  EXPECT_EQ(bus->acknowledged(), 2 * text.size());
  EXPECT_EQ(bus->statistics().malformed, 0U);
}

TEST_F(TextBusTest, GarbageAndOversizedAndCutLinesAreCountedAndPassedOver) {
  pty.say("\x01\xff\xfe garbage\r");                 // 1
  pty.say("t10120\r");                               // 2: cut
  pty.say("t1012" + std::string(2000, '0') + "\r");  // 3: longer than any line
  pty.say("t9992ABCD\r");                            // 4: no such id
  pty.say(std::string(4000, '#') + "\a");            // 5: long, and no bell either
  pty.say("\a");                                     // the adapter refuses something
  pty.say("t10121234\r");
  ASSERT_TRUE(next());
  EXPECT_EQ(frame.id, 0x101U);
  EXPECT_EQ(bus->statistics().malformed, 5U);
  EXPECT_EQ(bus->statistics().errors, 1U);
  EXPECT_EQ(bus->statistics().received, 1U);
}

// A bus cannot know what was said before: telling old from new is the business of whoever asked.
TEST_F(TextBusTest, ReplayedFramesArriveAsOftenAsTheyAreSaid) {
  for (int i = 0; i < 5; ++i) pty.say("t10120102\r");
  for (int i = 0; i < 5; ++i) ASSERT_TRUE(next());
  EXPECT_TRUE(drained());
  EXPECT_EQ(bus->statistics().received, 5U);
}

TEST_F(TextBusTest, WhoTalksForEverWithoutSayingAFrameDoesNotKeepTheExchange) {
  std::atomic<bool> over{false};
  std::thread babbler([&] {
    while (!over.load(std::memory_order_relaxed)) pty.say("zzzz\r");
  });
  for (int i = 0; i < 1000; ++i) EXPECT_FALSE(bus->receive(frame));
  ASSERT_TRUE(test::await([&] {
    bus->receive(frame);
    return bus->statistics().malformed > 1000;
  }));
  std::thread drain([&] {
    while (!over.load(std::memory_order_relaxed)) bus->receive(frame);
  });
  std::this_thread::sleep_for(std::chrono::milliseconds(5));
  over.store(true, std::memory_order_relaxed);
  babbler.join();
  drain.join();
}

// The adapter takes nothing for a while: what it then hears are whole lines, the newest command is among them, and what
// was overtaken is not.
TEST_F(TextBusTest, CommandsThatCouldNotLeaveAreOvertakenByTheNextOnesButNoLineIsBroken) {
  std::uint32_t number = 0;
  std::uint64_t asked = 0;
  while (bus->statistics().refused == 0 && number < 10'000) {
    bus->begin(0);
    for (int i = 0; i < 40; ++i, ++asked) EXPECT_TRUE(bus->send(command(number % 0x800, 8)));
    bus->flush();
    ++number;
  }
  ASSERT_GT(bus->statistics().refused, 0U) << "the terminal never became full";
  for (int i = 0; i < 50; ++i, ++number, ++asked) {
    bus->begin(0);
    EXPECT_TRUE(bus->send(command(number % 0x800, 8)));
    bus->flush();
  }
  std::string heard;
  std::size_t lines = 0;
  std::uint32_t newest = 0;
  ASSERT_TRUE(test::await([&] {
    heard += pty.heard();
    bus->receive(frame);  // makes the rest leave
    for (std::size_t end = 0; (end = heard.find('\r')) != std::string::npos; heard.erase(0, end + 1)) {
      EXPECT_EQ(slcan::parse_request(std::string_view(heard).substr(0, end), frame), slcan::Request::send) << heard;
      newest = frame.id;
      ++lines;
    }
    return newest == (number - 1) % 0x800;
  }));
  EXPECT_EQ(lines, bus->statistics().sent) << "what was overtaken was not sent";
  // How many those are depends on when the kernel moves what is in the terminal.
  EXPECT_EQ(bus->statistics().sent + bus->statistics().refused, asked);
}

TEST_F(TextBusTest, MoreCommandsThanThereIsRoomForAreRefusedAndCounted) {
  bus->begin(0);
  std::size_t taken = 0;
  while (bus->send(command(1, 8))) ++taken;
  EXPECT_EQ(taken, 16384U / 22U);
  EXPECT_FALSE(bus->send(command(1, 8)));
  EXPECT_EQ(bus->statistics().refused, 2U);
  bus->flush();
  std::size_t lines = 0;
  ASSERT_TRUE(test::await([&] {
    bus->receive(frame);
    for (const char c : pty.heard()) lines += c == '\r' ? 1 : 0;
    return lines == taken;
  })) << "nothing of what it took is lost";
}

TEST_F(TextBusTest, AnAdapterPulledOutInMidLineIsCountedNamedAndTakenBack) {
  pty.say("t10120102\rt1012");
  ASSERT_TRUE(next());
  pty.unplug();
  ASSERT_TRUE(test::await([&] { return !bus->receive(frame) && !bus->why_down().empty(); }));
  EXPECT_NE(bus->why_down().find(pty.path()), std::string::npos);
  bus->begin(0);
  EXPECT_FALSE(bus->send(command(1, 1))) << "refused, not kept for later";
  EXPECT_EQ(bus->reply_wait_ns(), 0) << "no answer will come";
  bus->flush();
  EXPECT_EQ(bus->statistics().refused, 1U);
  bus->service();
  EXPECT_NE(bus->why_down().find("plug the adapter in"), std::string::npos) << bus->why_down();
  bus->begin(0);
  EXPECT_FALSE(bus->receive(frame));

  pty.plug_in();
  bus->service();
  EXPECT_EQ(bus->why_down(), "");
  EXPECT_EQ(pty.heard_until("O\r"), kGreeting) << "a new adapter knows no bit rate";
  pty.say("0304\rt2000\r");
  bus->begin(0);
  ASSERT_TRUE(next());
  EXPECT_EQ(frame.id, 0x200U) << "the half line of the old adapter and the new one's are no frame together";
  EXPECT_EQ(bus->statistics().malformed, 1U);
  EXPECT_EQ(bus->statistics().reopened, 1U);
  EXPECT_TRUE(bus->send(command(1, 1)));
  bus->flush();
  EXPECT_EQ(pty.heard_until("\r"), "t001101\r");
}

TEST_F(TextBusTest, AnAdapterPulledOutInALineWithoutEndIsForgottenAsWell) {
  pty.say("t10120102\r" + std::string(1000, '#'));
  ASSERT_TRUE(next());
  pty.unplug();
  ASSERT_TRUE(test::await([&] { return !bus->receive(frame) && !bus->why_down().empty(); }));
  pty.plug_in();
  bus->service();
  bus->begin(0);
  pty.say("t2000\r");
  ASSERT_TRUE(next());
  EXPECT_EQ(frame.id, 0x200U);
  EXPECT_EQ(bus->statistics().malformed, 0U);
}

TEST_F(TextBusTest, AnExchangeAllocatesNothingWhateverHappens) {
  const auto exchange = [this] {
    bus->begin(0);
    for (int i = 0; i < 40; ++i) bus->send(command(5, 8));
    bus->flush();
    for (int i = 0; i < 100; ++i) bus->receive(frame);
  };
  pty.say("t10120102\r\a#garbage#\rt1012");
  ASSERT_TRUE(next());
  pty.say("3333\r" + std::string(500, 'x') + "\r");
  {
    const NoAllocScope scope;
    for (int i = 0; i < 200; ++i) exchange();  // until the terminal is full
  }
  pty.unplug();
  {
    const NoAllocScope scope;
    for (int i = 0; i < 10; ++i) exchange();
  }
  EXPECT_NE(bus->why_down(), "");
}

TEST_F(TextBusTest, HousekeepingBringsItBackWhileExchangesGoOn) {
  std::atomic<bool> over{false};
  std::thread housekeeping([&] {
    while (!over.load(std::memory_order_relaxed)) {
      bus->service();
      bus->why_down();
      std::this_thread::yield();
    }
  });
  for (std::uint64_t times = 1; times <= 30; ++times) {
    pty.unplug();
    pty.plug_in();
    EXPECT_TRUE(test::await([&] {
      bus->begin(0);
      bus->send(command(3, 3));
      bus->flush();
      bus->receive(frame);
      return bus->statistics().reopened == times;
    }));
  }
  over.store(true, std::memory_order_relaxed);
  housekeeping.join();
}

// C is a hex digit: behind half a line it would end it, as a command that nobody gave.
TEST_F(TextBusTest, TheLastWordIsNoPartOfACommand) {
  const std::string line = "t00181011121314151617\r";
  Frame out;
  ASSERT_EQ(slcan::parse_request(std::string_view(line).substr(0, line.size() - 1), out), slcan::Request::send);
  bool cut = false;
  for (int tries = 0; tries < 40 && !cut; ++tries) {
    for (int i = 0; i < 2'000; ++i) {
      bus->begin(0);
      for (int k = 0; k < 7 + tries; ++k) bus->send(out);
      bus->flush();
    }
    std::string heard = pty.heard();  // now there is room for a last word
    cut = heard.size() % line.size() != 0;
    if (!cut) continue;
    bus.reset();
    ASSERT_TRUE(test::await([&] {
      const std::string more = pty.heard();
      heard += more;
      return more.empty() && heard.back() == '\r';
    }));
    for (std::size_t end = 0; (end = heard.find('\r')) != std::string::npos; heard.erase(0, end + 1)) {
      const std::string each = heard.substr(0, end + 1);
      ASSERT_TRUE(each == line || (each == "C\r" && end + 1 == heard.size())) << each;
    }
  }
  EXPECT_TRUE(cut) << "the terminal never stood full in the middle of a line";
}

TEST_F(TextBusTest, AnAdapterThatTakesNoCommandsIsRefused) {
  bus.reset();
  pty.heard_until("C\r");
  Descriptor other(open(pty.path().c_str(), O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC));
  // Output that is stopped stays stopped for whoever opens it next.
  ASSERT_EQ(tcflow(other.get(), TCOOFF), 0);
  const auto opened = SlcanBus::open({pty.path()});
  ASSERT_FALSE(opened);
  EXPECT_NE(opened.message().find("takes no commands"), std::string::npos) << opened.message();
}

TEST_F(TextBusTest, TheChannelIsClosedAtTheEnd) {
  bus.reset();
  EXPECT_EQ(pty.heard_until("C\r"), "C\r");
}

}  // namespace
}  // namespace lithe::hal
