// SPDX-License-Identifier: Apache-2.0
// What a robot file says reaches the wire.
#include "spine/hal/open_bus.hpp"

#include <gtest/gtest.h>
#include <termios.h>

#include "spine/hal/bus/test/pty_rig.hpp"
#include "spine/hal/core/descriptor.hpp"
#include "spine/hal/registry.hpp"

namespace lithe::hal {
namespace {

robot::BusConfig config_of(const test::TestPty& pty, robot::BusKind kind = robot::BusKind::fdcanusb) {
  robot::BusConfig config;
  config.name = "b";
  config.kind = kind;
  config.path = pty.path();
  return config;
}

// All that is said when it is opened and one frame is sent.
std::string said(test::TestPty& pty, const robot::BusConfig& config) {
  const auto bus = BusOpener({}, false).open(config);
  EXPECT_TRUE(bus) << bus.message();
  if (!bus) return "";
  Frame frame = test::command(0x8001, 2);
  frame.extended = frame.fd = frame.brs = true;
  (*bus)->begin(0);
  EXPECT_TRUE((*bus)->send(frame));
  (*bus)->flush();
  std::string all;
  test::await([&] {
    all += pty.heard();
    const std::size_t at = all.find("can send");
    return at != std::string::npos && all.find('\n', at) != std::string::npos;
  });
  return all;
}

// A drive there executes what is left of a damaged command; it gives and demands sums only when its host has begun.
TEST(OpenBus, ADriveOnAUartGetsChecksumsFromTheFirstByteOn) {
  test::TestPty pty;
  const std::string all = said(pty, config_of(pty));
  EXPECT_EQ(all.substr(0, 8), "can on *") << all;
  EXPECT_NE(all.find(" BF *"), std::string::npos) << all;
}

TEST(OpenBus, TheFileHasTheLastWordOnChecksums) {
  test::TestPty pty;
  robot::BusConfig config = config_of(pty);
  config.keys.fdcanusb.checksums = Checksums::off;
  EXPECT_EQ(said(pty, config).find('*'), std::string::npos);
  config.keys.fdcanusb.checksums = Checksums::on;
  EXPECT_NE(said(pty, config).find(" BF *"), std::string::npos);
}

TEST(OpenBus, ABaudRateOfTheFileIsSet) {
  test::TestPty pty;
  const Descriptor probe(open(pty.path().c_str(), O_RDWR | O_NOCTTY | O_CLOEXEC));
  termios kept{};
  ASSERT_EQ(tcgetattr(probe.get(), &kept), 0);
  ASSERT_EQ(cfsetspeed(&kept, B2000000), 0);
  ASSERT_EQ(tcsetattr(probe.get(), TCSANOW, &kept), 0);
  ASSERT_EQ(tcgetattr(probe.get(), &kept), 0);
  if (cfgetospeed(&kept) != B2000000) GTEST_SKIP() << "this system's terminals keep no such rate (qemu-user)";
  for (const robot::BusKind kind : {robot::BusKind::fdcanusb, robot::BusKind::slcan}) {
    for (const auto& [baud, code] : {std::pair{0U, B921600}, {115'200U, B115200}, {2'000'000U, B2000000}}) {
      robot::BusConfig config = config_of(pty, kind);
      config.baud = baud;
      const auto bus = BusOpener({}, false).open(config);
      ASSERT_TRUE(bus) << bus.message();
      const Descriptor again(open(pty.path().c_str(), O_RDWR | O_NOCTTY | O_CLOEXEC));
      termios settings{};
      ASSERT_EQ(tcgetattr(again.get(), &settings), 0);
      EXPECT_EQ(cfgetospeed(&settings), speed_t(code)) << baud;
    }
    robot::BusConfig odd = config_of(pty, kind);
    odd.baud = 12'345;
    const auto bus = BusOpener({}, false).open(odd);
    ASSERT_FALSE(bus);
    EXPECT_NE(bus.message().find("no baud rate of 12345; use one of 115200, "), std::string::npos) << bus.message();
  }
}

// A row that lacks half of a board would be a null call in `lithe run`, `lithe bus plan` or `lithe check`.
TEST(OpenBus, EveryKindIsOpenedInOneWayAndABoardHasAllThatOneNeeds) {
  for (const BusType& type : bus_types()) {
    const robot::BusFacts& facts = robot::facts(type.kind);
    SCOPED_TRACE(facts.word);
    const bool board = type.open_board != nullptr;
    EXPECT_EQ(facts.real, board != (type.open != nullptr));
    EXPECT_EQ(board, facts.connectors > 0);
    EXPECT_EQ(board, facts.place == robot::PlaceKey::connector);
    EXPECT_TRUE(board || !facts.real || !facts.has_imu);
    EXPECT_EQ(board, type.processor_of != nullptr && type.transfer_us != nullptr && type.poll_us != nullptr);
    robot::BusConfig bus;
    for (bus.connector = 1; board && bus.connector <= facts.connectors; ++bus.connector)
      EXPECT_LT(type.processor_of(bus), type.processors.size());
  }
}

}  // namespace
}  // namespace lithe::hal
