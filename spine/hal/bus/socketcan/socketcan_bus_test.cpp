// SPDX-License-Identifier: Apache-2.0
// The kernel's side is a socket of the test's. What needs a CAN interface is in test/socketcan_interface_test.cpp.
#include "spine/hal/bus/socketcan/socketcan_bus.hpp"

#include <gtest/gtest.h>
#include <linux/can/error.h>
#include <sys/socket.h>
#include <sys/timerfd.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <csignal>
#include <thread>

#include "spine/core/test/no_alloc_rig.hpp"
#include "spine/hal/bus/test/pty_rig.hpp"

namespace lithe::hal {
namespace {

using test::command;

Frame fd_command(std::uint32_t id, std::uint8_t size) {
  Frame frame = command(id, size);
  frame.fd = frame.brs = true;
  return frame;
}

class SocketCanBusTest : public ::testing::Test {
 protected:
  SocketCanBusTest() {
    signal(SIGPIPE, SIG_IGN);  // which the kernel's own CAN sockets never send
    open(5'000'000);
  }
  void TearDown() override { close(kernel_); }

  void open(std::uint32_t data_bitrate) {
    auto opened =
        SocketCanBus::open({"can7", 1'000'000, data_bitrate}, [this] { return connect(); }, [this] { return carrier; });
    ASSERT_TRUE(opened) << opened.message();
    bus = std::move(*opened);
  }
  Result<Descriptor> connect() {
    if (gone) return Error{"can7: no such interface"};
    std::array<int, 2> ends{};
    if (socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_NONBLOCK, 0, ends.data()) != 0) return Error{"no socketpair"};
    close(kernel_);
    kernel_ = ends[1];
    return Descriptor(ends[0]);
  }
  void unplug() {
    close(kernel_);
    kernel_ = -1;
  }

  // From the kernel.
  void say(const canfd_frame& raw, std::size_t size) { ASSERT_EQ(write(kernel_, &raw, size), ssize_t(size)); }
  template <std::size_t N>
  void say(const std::array<char, N>& bytes) {
    ASSERT_EQ(write(kernel_, bytes.data(), N), ssize_t(N));
  }
  void say(const Frame& spoken) {
    canfd_frame raw;
    const std::size_t size = socketcan::encode(spoken, raw);
    say(raw, size);
  }
  void say_error(canid_t kinds) {
    canfd_frame raw{};
    raw.can_id = CAN_ERR_FLAG | kinds;
    raw.len = CAN_ERR_DLC;
    say(raw, CAN_MTU);
  }
  void try_to_say(const canfd_frame& raw) { static_cast<void>(!write(kernel_, &raw, CAN_MTU)); }
  // Length of what reached it; 0: nothing.
  std::size_t heard(canfd_frame& raw) {
    const ssize_t size = read(kernel_, &raw, sizeof raw);
    return size > 0 ? static_cast<std::size_t>(size) : 0;
  }

  bool gone = false;
  SocketCanBus::Carrier carrier = SocketCanBus::Carrier::unknown;
  std::unique_ptr<SocketCanBus> bus;
  Frame frame;

 private:
  int kernel_ = -1;
};

TEST_F(SocketCanBusTest, FramesLeaveAsTheyAreSentClassicAndFd) {
  bus->begin(0);
  EXPECT_TRUE(bus->send(command(0x101, 8)));
  EXPECT_TRUE(bus->send(fd_command(0x102, 48)));
  canfd_frame raw;
  EXPECT_EQ(heard(raw), CAN_MTU);
  EXPECT_EQ(heard(raw), CANFD_MTU);
  EXPECT_EQ(raw.can_id, 0x102U);
  EXPECT_EQ(raw.flags, CANFD_BRS);
  EXPECT_EQ(raw.len, 48);
  EXPECT_EQ(bus->statistics().sent, 2U);
}

TEST_F(SocketCanBusTest, AClassicBusRefusesFd) {
  open(0);
  EXPECT_FALSE(bus->send(fd_command(0x102, 8)));
  EXPECT_EQ(bus->statistics().refused, 1U);
  EXPECT_TRUE(bus->send(command(0x102, 8)));
}

TEST_F(SocketCanBusTest, AnswersComeInOrderAndNonsenseIsCounted) {
  say(command(0x201, 3));
  canfd_frame raw{};
  say(raw, 15);  // no frame of the kernel's
  raw.len = 77;
  say(raw, CAN_MTU);  // nor this
  raw = {};
  raw.can_id = 0x701 | CAN_RTR_FLAG;  // makes sense, and nobody waits for it
  say(raw, CAN_MTU);
  say(std::array<char, 100>{});  // nor this
  say(fd_command(0x202, 64));
  ASSERT_TRUE(bus->receive(frame));
  EXPECT_EQ(frame.id, 0x201U);
  ASSERT_TRUE(bus->receive(frame));
  EXPECT_EQ(frame.id, 0x202U);
  EXPECT_EQ(frame.size, 64);
  EXPECT_FALSE(bus->receive(frame));
  EXPECT_EQ(bus->statistics().received, 2U);
  EXPECT_EQ(bus->statistics().malformed, 3U);
  EXPECT_EQ(bus->statistics().ignored, 1U);
}

TEST_F(SocketCanBusTest, AFullInterfaceRefusesAndCounts) {
  bus->begin(0);
  std::uint64_t taken = 0;
  while (taken < 100'000 && bus->send(command(1, 8))) ++taken;
  EXPECT_EQ(bus->statistics().refused, 1U);
  EXPECT_EQ(bus->why_down(), "") << "full is not broken";
  canfd_frame raw;
  while (heard(raw) > 0) --taken;
  EXPECT_EQ(taken, 0U);
  EXPECT_TRUE(bus->send(command(1, 8)));
}

// Drives without power: the controller repeats the first frame for ever, and what is behind it waits. When they come
// back they must not be given what was wanted long ago.
TEST_F(SocketCanBusTest, WhatDoesNotLeaveKeepsLaterCommandsFromPilingUp) {
  const auto exchange = [&](std::uint32_t number) {
    bus->begin(number);
    bool sent = true;
    for (std::uint32_t id = 1; id <= 4; ++id) sent = bus->send(command(16 * number + id, 8)) && sent;
    bus->flush();
    return sent;
  };
  std::array<int, 2> ends{};
  ASSERT_EQ(socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_NONBLOCK, 0, ends.data()), 0);
  const Descriptor full(ends[0]), unread(ends[1]);
  ASSERT_EQ(::write(ends[0], "x", 1), 1);
  if (full.unsent_bytes() == 0) GTEST_SKIP() << "this system does not tell what has not left (qemu-user)";
  EXPECT_TRUE(exchange(1));
  for (std::uint32_t number = 2; number < 100; ++number) EXPECT_FALSE(exchange(number));
  EXPECT_EQ(bus->statistics().sent, 4U);
  EXPECT_EQ(bus->statistics().refused, 98U * 4U);
  EXPECT_EQ(bus->reply_wait_ns(), 0) << "no answer will come";
  EXPECT_NE(bus->why_down().find("commands are not sent"), std::string::npos) << bus->why_down();
  canfd_frame raw;
  for (std::uint32_t id = 1; id <= 4; ++id) {
    ASSERT_EQ(heard(raw), CAN_MTU);
    EXPECT_EQ(raw.can_id, 16 + id);
  }
  EXPECT_EQ(heard(raw), 0U) << "one exchange, and nothing of a hundred later ones";
  EXPECT_TRUE(exchange(100));
  EXPECT_EQ(bus->why_down(), "");
  ASSERT_EQ(heard(raw), CAN_MTU);
  EXPECT_EQ(raw.can_id, 1601U) << "the newest";
}

// Their error frame came before the socket was open, or found it full.
TEST_F(SocketCanBusTest, ABusOffThatNobodyToldIsSeenAndSoIsItsEnd) {
  carrier = SocketCanBus::Carrier::off;
  bus->service();
  bus->begin(0);
  EXPECT_FALSE(bus->send(command(1, 1)));
  EXPECT_NE(bus->why_down().find("bus-off"), std::string::npos) << bus->why_down();
  carrier = SocketCanBus::Carrier::on;
  bus->service();
  bus->begin(0);
  EXPECT_EQ(bus->why_down(), "");
  EXPECT_TRUE(bus->send(command(1, 1)));
  say_error(CAN_ERR_BUSOFF);
  EXPECT_FALSE(bus->receive(frame));
  carrier = SocketCanBus::Carrier::unknown;
  bus->service();
  bus->begin(0);
  EXPECT_NE(bus->why_down(), "") << "who knows nothing changes nothing";
}

// A timer takes no frames, and says so with the same error as an interface that lost its FD.
TEST_F(SocketCanBusTest, AFrameThatTheInterfaceDoesNotCarryIsNoReasonToGiveItUp) {
  const auto other = SocketCanBus::open(
      {"can7"}, [] { return Result<Descriptor>(Descriptor(timerfd_create(CLOCK_MONOTONIC, TFD_NONBLOCK))); },
      [] { return SocketCanBus::Carrier::unknown; });
  ASSERT_TRUE(other);
  EXPECT_FALSE((*other)->send(fd_command(1, 12)));
  EXPECT_EQ((*other)->statistics().refused, 1U);
  EXPECT_EQ((*other)->why_down(), "");
}

TEST_F(SocketCanBusTest, BusOffRefusesCommandsUntilTheControllerIsRestarted) {
  say_error(CAN_ERR_BUSOFF);
  EXPECT_FALSE(bus->receive(frame));
  EXPECT_FALSE(bus->send(command(1, 1))) << "it would wait, and leave when nobody wants it any more";
  EXPECT_EQ(bus->reply_wait_ns(), 0) << "no answer will come";
  EXPECT_NE(bus->why_down().find("sudo ip link set can7 type can restart"), std::string::npos) << bus->why_down();
  say_error(CAN_ERR_RESTARTED);
  EXPECT_FALSE(bus->receive(frame));
  EXPECT_EQ(bus->why_down(), "");
  EXPECT_TRUE(bus->send(command(1, 1)));
  EXPECT_EQ(bus->statistics().errors, 2U);
}

TEST_F(SocketCanBusTest, ABusFullOfErrorsDoesNotKeepTheExchange) {
  std::atomic<bool> over{false};
  std::thread wire([&] {
    canfd_frame raw{};
    raw.can_id = CAN_ERR_FLAG | CAN_ERR_PROT;
    raw.len = CAN_ERR_DLC;
    while (!over.load(std::memory_order_relaxed)) try_to_say(raw);
  });
  EXPECT_TRUE(test::await([&] { return !bus->receive(frame) && bus->statistics().errors > 0; }));
  for (int i = 0; i < 200; ++i) EXPECT_FALSE(bus->receive(frame)) << "it comes back, though errors go on and on";
  over.store(true, std::memory_order_relaxed);
  wire.join();
}

// Who asks drains first, and takes what comes afterwards for an answer.
TEST_F(SocketCanBusTest, ErrorsDoNotHideTheFrameBehindThem) {
  for (int i = 0; i < 100; ++i) say_error(CAN_ERR_PROT);
  say(command(1, 1));
  EXPECT_TRUE(bus->receive(frame)) << "in one drain";
  EXPECT_EQ(bus->statistics().errors, 100U);
}

TEST_F(SocketCanBusTest, AnInterfaceThatGoesAwayIsNamedAndTakenBack) {
  unplug();
  EXPECT_FALSE(bus->receive(frame));
  EXPECT_NE(bus->why_down().find("can7"), std::string::npos);
  bus->begin(0);
  EXPECT_FALSE(bus->send(command(1, 1)));
  EXPECT_FALSE(bus->receive(frame));
  gone = true;
  bus->service();
  EXPECT_EQ(bus->why_down(), "can7: no such interface");
  EXPECT_EQ(bus->reply_wait_ns(), 0);
  gone = false;
  bus->service();
  EXPECT_EQ(bus->why_down(), "");
  EXPECT_FALSE(bus->send(command(1, 1))) << "from the next exchange on";
  bus->begin(0);
  EXPECT_TRUE(bus->send(command(1, 1)));
  EXPECT_EQ(bus->statistics().reopened, 1U);
  EXPECT_GT(bus->reply_wait_ns(), 0);
  say(command(2, 2));
  EXPECT_TRUE(bus->receive(frame));
}

TEST_F(SocketCanBusTest, ANewInterfaceIsNotBusOff) {
  say_error(CAN_ERR_BUSOFF);
  EXPECT_FALSE(bus->receive(frame));
  unplug();
  EXPECT_FALSE(bus->receive(frame));
  bus->service();
  bus->begin(0);
  EXPECT_TRUE(bus->send(command(1, 1)));
}

TEST_F(SocketCanBusTest, AnExchangeAllocatesNothingWhateverHappens) {
  const auto exchange = [this] {
    bus->begin(0);
    for (int i = 0; i < 40; ++i) bus->send(fd_command(5, 64));
    bus->flush();
    for (int i = 0; i < 100; ++i) bus->receive(frame);
  };
  say(command(2, 2));
  say_error(CAN_ERR_BUSOFF);
  say_error(CAN_ERR_RESTARTED);
  {
    const NoAllocScope scope;
    for (int i = 0; i < 50; ++i) exchange();
    unplug();
    for (int i = 0; i < 10; ++i) exchange();
  }
  EXPECT_NE(bus->why_down(), "");
}

TEST_F(SocketCanBusTest, HousekeepingBringsItBackWhileExchangesGoOn) {
  std::atomic<bool> over{false};
  std::atomic<bool> pulled{false};
  std::thread housekeeping([&] {
    while (!over.load(std::memory_order_relaxed)) {
      bus->service();
      bus->why_down();
      if (pulled.exchange(false, std::memory_order_acq_rel)) unplug();
      std::this_thread::yield();
    }
  });
  for (std::uint64_t times = 1; times <= 30; ++times) {
    pulled.store(true, std::memory_order_release);
    EXPECT_TRUE(test::await([&] {
      bus->begin(0);
      bus->send(command(3, 3));
      bus->receive(frame);
      return bus->statistics().reopened == times;
    }));
  }
  over.store(true, std::memory_order_relaxed);
  housekeeping.join();
}

TEST(SocketCan, SaysWhatIsMissingAndWhatToDo) {
  for (const char* name : {"", "lo", "nosuch0", "a-name-that-is-too-long-for-an-interface"}) {
    const auto opened = SocketCanBus::open({name});
    ASSERT_FALSE(opened) << name;
    EXPECT_TRUE(opened.message().starts_with(std::string(name) + ": ")) << opened.message();
    EXPECT_NE(opened.message().find("ip -br"), std::string::npos) << "a command to type: " << opened.message();
  }
}

}  // namespace
}  // namespace lithe::hal
