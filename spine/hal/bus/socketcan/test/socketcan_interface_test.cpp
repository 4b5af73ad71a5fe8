// SPDX-License-Identifier: Apache-2.0
// On a CAN interface of the kernel's, which LITHE_CAN_INTERFACE names and which the tests take down and away: as root,
// in a machine of its own (tools/vm/vcan.py boots one).
#include <gtest/gtest.h>
#include <linux/can/error.h>
#include <net/if.h>
#include <sys/ioctl.h>
#include <sys/socket.h>

#include <cstdlib>
#include <cstring>
#include <string>

#include "spine/hal/bus/socketcan/socketcan_bus.hpp"
#include "spine/hal/bus/test/pty_rig.hpp"

namespace lithe::hal {
namespace {

using test::command;

class SocketCanInterface : public ::testing::Test {
 protected:
  void SetUp() override {
    const char* name = std::getenv("LITHE_CAN_INTERFACE");
    if (name == nullptr) GTEST_SKIP() << "LITHE_CAN_INTERFACE names no CAN interface (python tools/vm/vcan.py has one)";
    interface = name;
    set_up(true);
    bus = open();
    peer = open();
  }

  std::unique_ptr<SocketCanBus> open(std::uint32_t data_bitrate = 5'000'000) {
    auto opened = SocketCanBus::open({interface, 1'000'000, data_bitrate});
    EXPECT_TRUE(opened) << (opened ? "" : opened.message());
    return opened ? std::move(*opened) : nullptr;
  }
  void configure(unsigned long what, ifreq& request) {
    const Descriptor socket(::socket(AF_INET, SOCK_DGRAM, 0));
    std::strncpy(request.ifr_name, interface.c_str(), sizeof request.ifr_name - 1);
    ASSERT_EQ(ioctl(socket.get(), what, &request), 0) << std::strerror(errno);
  }
  void set_up(bool up) {
    ifreq request{};
    request.ifr_flags = up ? IFF_UP | IFF_NOARP : IFF_NOARP;
    configure(SIOCSIFFLAGS, request);
  }
  void set_mtu(int mtu) {
    set_up(false);
    ifreq request{};
    request.ifr_mtu = mtu;
    configure(SIOCSIFMTU, request);
    set_up(true);
  }
  void type(const std::string& words) { ASSERT_EQ(std::system(("ip link " + words).c_str()), 0) << words; }

  std::string interface;
  std::unique_ptr<SocketCanBus> bus;
  std::unique_ptr<SocketCanBus> peer;
  Frame frame;
};

TEST_F(SocketCanInterface, FramesOfEveryKindArriveAsTheyLeftAndNotAtTheirSender) {
  for (const bool extended : {false, true}) {
    for (const int kind : {0, 1, 2}) {  // classic, FD, FD with the faster data phase
      for (std::size_t size = 0; size <= (kind > 0 ? kMaxPayload : 8); size = fd_size(size + 1)) {
        Frame out = command(extended ? 0x12345678 : 0x123, static_cast<std::uint8_t>(size));
        out.extended = extended;
        out.fd = kind > 0;
        out.brs = kind > 1;
        ASSERT_TRUE(bus->send(out));
        ASSERT_TRUE(test::next(*peer, frame));
        EXPECT_EQ(frame.id, out.id);
        EXPECT_EQ(frame.extended, out.extended);
        EXPECT_EQ(frame.fd, out.fd);
        EXPECT_EQ(frame.brs, out.brs);
        EXPECT_EQ(frame.size, out.size);
        EXPECT_EQ(frame.data, out.data);
        if (size == kMaxPayload) break;
      }
    }
  }
  EXPECT_FALSE(bus->receive(frame)) << "its own frames";
  EXPECT_EQ(peer->statistics().malformed, 0U);
}

TEST_F(SocketCanInterface, ManyExchangesLoseNothing) {
  std::uint64_t answers = 0;
  for (int exchange = 0; exchange < 500; ++exchange) {
    bus->begin(exchange);
    for (std::uint32_t id = 1; id <= 32; ++id) {
      Frame out = command(id, 48);
      out.fd = out.brs = true;
      ASSERT_TRUE(bus->send(out));
    }
    bus->flush();
    for (int i = 0; i < 32; ++i) {
      ASSERT_TRUE(test::next(*peer, frame));
      ASSERT_TRUE(peer->send(frame));
    }
    while (bus->receive(frame)) ++answers;
  }
  EXPECT_EQ(answers, 500U * 32U);
  EXPECT_EQ(bus->statistics().refused, 0U);
}

TEST_F(SocketCanInterface, WhatTheInterfaceHasTakenIsNoReasonToWait) {
  EXPECT_EQ(look_at_carrier(interface), SocketCanBus::Carrier::on);
  EXPECT_EQ(look_at_carrier("nosuch0"), SocketCanBus::Carrier::unknown);
  for (int exchange = 0; exchange < 10; ++exchange) {
    bus->begin(exchange);
    bus->service();
    for (std::uint32_t id = 1; id <= 32; ++id) ASSERT_TRUE(bus->send(command(id, 8)));
  }
  EXPECT_EQ(bus->why_down(), "");
}

TEST_F(SocketCanInterface, ErrorFramesOfTheKernelAreUnderstood) {
  const Result<Descriptor> kernel = open_can_socket({interface});
  ASSERT_TRUE(kernel) << kernel.message();
  const auto tell = [&](canid_t kinds) {
    canfd_frame raw{};
    raw.can_id = CAN_ERR_FLAG | kinds;
    raw.len = CAN_ERR_DLC;
    EXPECT_EQ(kernel->write(std::as_bytes(std::span(&raw, 1)).first(CAN_MTU)).bytes, CAN_MTU);
  };
  tell(CAN_ERR_BUSOFF);
  EXPECT_TRUE(test::await([&] { return !bus->receive(frame) && !bus->why_down().empty(); }));
  EXPECT_FALSE(bus->send(command(1, 1)));
  tell(CAN_ERR_RESTARTED);
  EXPECT_TRUE(test::await([&] { return !bus->receive(frame) && bus->why_down().empty(); }));
  EXPECT_TRUE(bus->send(command(1, 1)));
}

TEST_F(SocketCanInterface, DownAndUpAgainIsSurvived) {
  set_up(false);
  EXPECT_FALSE(bus->receive(frame));
  EXPECT_FALSE(bus->send(command(1, 1)));
  EXPECT_NE(bus->why_down(), "");
  bus->service();
  EXPECT_EQ(bus->why_down(), interface + ": is down: sudo ip link set " + interface +
                                 " up txqueuelen 128 type can bitrate 1000000 restart-ms 100 dbitrate 5000000 fd on "
                                 "sample-point 0.666 dsample-point 0.666 sjw 10 dsjw 5");
  set_up(true);
  bus->service();
  EXPECT_EQ(bus->why_down(), "");
  bus->begin(0);
  EXPECT_EQ(bus->statistics().reopened, 1U);
  EXPECT_FALSE(peer->send(command(2, 2))) << "the peer has not been told yet";
  peer->service();
  peer->begin(0);
  EXPECT_TRUE(peer->send(command(2, 2)));
  EXPECT_TRUE(test::next(*bus, frame));
  EXPECT_TRUE(bus->send(command(1, 1)));
  EXPECT_TRUE(test::next(*peer, frame));
}

TEST_F(SocketCanInterface, GoneAndPluggedInAgainIsSurvived) {
  type("del " + interface);
  EXPECT_FALSE(bus->receive(frame));
  EXPECT_FALSE(bus->send(command(1, 1)));
  bus->service();
  EXPECT_NE(bus->why_down().find("no such interface"), std::string::npos) << bus->why_down();
  type("add dev " + interface + " type vcan");
  bus->service();
  EXPECT_NE(bus->why_down().find("is down"), std::string::npos) << bus->why_down();
  set_up(true);
  bus->service();
  bus->begin(0);
  EXPECT_EQ(bus->statistics().reopened, 1U);
  peer = open();
  EXPECT_TRUE(bus->send(command(1, 1)));
  EXPECT_TRUE(test::next(*peer, frame));
}

TEST_F(SocketCanInterface, OneThatCarriesClassicCanOnlyIsRefusedWhereFdIsWanted) {
  set_mtu(CAN_MTU);
  const auto fd = SocketCanBus::open({interface});
  ASSERT_FALSE(fd);
  EXPECT_NE(fd.message().find("sjw 10 dsjw 5; or set data_bitrate = 0"), std::string::npos) << fd.message();
  const auto classic = open(0);
  const auto listener = open(0);
  EXPECT_TRUE(classic->send(command(1, 8)));
  EXPECT_TRUE(test::next(*listener, frame));
  Frame too_long = command(1, 12);
  too_long.fd = true;
  EXPECT_FALSE(classic->send(too_long));
  EXPECT_FALSE(bus->send(too_long)) << "opened while it could; refused by the kernel now";
  set_mtu(CANFD_MTU);
}

}  // namespace
}  // namespace lithe::hal
