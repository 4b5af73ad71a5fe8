// SPDX-License-Identifier: Apache-2.0
// A socket of the loopback's stands for the kernel's CAN: one drops as the other does, when nobody reads.
#include <gtest/gtest.h>
#include <linux/sock_diag.h>
#include <netinet/in.h>
#include <sys/socket.h>

#include <array>

#include "spine/hal/bus/socketcan/socketcan_bus.hpp"

namespace lithe::hal {
namespace {

// Both ends of a wire of datagrams; -1 where there is none.
std::array<int, 2> datagrams() {
  const int reader = ::socket(AF_INET, SOCK_DGRAM | SOCK_NONBLOCK, 0);
  sockaddr_in here{};
  here.sin_family = AF_INET;
  here.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t size = sizeof here;
  if (::bind(reader, reinterpret_cast<sockaddr*>(&here), size) != 0) return {reader, -1};
  getsockname(reader, reinterpret_cast<sockaddr*>(&here), &size);
  const int writer = ::socket(AF_INET, SOCK_DGRAM, 0);
  if (::connect(writer, reinterpret_cast<sockaddr*>(&here), size) != 0) return {reader, -1};
  return {reader, writer};
}

TEST(SocketCanOverrun, WhatTheKernelDropsBecauseNobodyReadsIsCounted) {
  const auto [reader, writer] = datagrams();
  const Descriptor far(writer);
  ASSERT_TRUE(far.is_open()) << "no loopback";
  Descriptor near(reader);
  std::array<std::uint32_t, SK_MEMINFO_VARS> memory{};
  socklen_t bytes = sizeof memory;
  const int failed = getsockopt(reader, SOL_SOCKET, SO_MEMINFO, memory.data(), &bytes);
  if (failed != 0 || bytes <= SK_MEMINFO_DROPS * sizeof memory[0])  // qemu-user takes it for one number
    GTEST_SKIP() << "this system does not count what it drops (qemu-user)";
  auto opened = SocketCanBus::open(
      {"can7", 1'000'000, 0}, [&near]() -> Result<Descriptor> { return std::move(near); },
      [] { return SocketCanBus::Carrier::unknown; });
  ASSERT_TRUE(opened) << opened.message();
  SocketCanBus& bus = **opened;
  bus.begin(0);
  EXPECT_EQ(bus.overrun(), 0U);
  canfd_frame raw{};
  raw.can_id = 0x101;
  raw.len = 8;
  constexpr std::uint64_t kSaid = 5'000;  // its room is for a few hundred
  for (std::uint64_t i = 0; i < kSaid; ++i)
    ASSERT_EQ(far.write(std::as_bytes(std::span(&raw, 1)).first(CAN_MTU)).bytes, std::size_t{CAN_MTU});
  Frame frame;
  while (bus.receive(frame)) {
  }
  EXPECT_GT(bus.overrun(), 0U);
  EXPECT_EQ(bus.statistics().received + bus.overrun(), kSaid);
}

}  // namespace
}  // namespace lithe::hal
