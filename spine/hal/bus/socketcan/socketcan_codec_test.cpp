// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/bus/socketcan/socketcan_codec.hpp"

#include <gtest/gtest.h>
#include <linux/can/error.h>

#include <cstring>
#include <random>
#include <vector>

namespace lithe::hal::socketcan {
namespace {

std::span<const std::byte> bytes_of(const canfd_frame& raw, std::size_t size) {
  return std::as_bytes(std::span(&raw, 1)).first(size);
}

canfd_frame error_frame(canid_t kinds, std::uint8_t controller = 0) {
  canfd_frame raw{};
  raw.can_id = CAN_ERR_FLAG | kinds;
  raw.len = CAN_ERR_DLC;
  raw.data[1] = controller;
  return raw;
}

TEST(SocketCanCodec, ClassicAndFdFramesAreTheKernelsByteForByte) {
  Frame frame;
  frame.id = 0x123;
  frame.size = 2;
  frame.data = {0xaa, 0xbb};
  canfd_frame raw;
  ASSERT_EQ(encode(frame, raw), CAN_MTU);
  const std::vector<std::uint8_t> classic{0x23, 1, 0, 0, 2, 0, 0, 0, 0xaa, 0xbb, 0, 0, 0, 0, 0, 0};
  EXPECT_EQ(std::memcmp(&raw, classic.data(), classic.size()), 0);

  frame.id = 0x8001;
  frame.extended = frame.fd = frame.brs = true;
  ASSERT_EQ(encode(frame, raw), CANFD_MTU);
  const std::vector<std::uint8_t> fd{0x01, 0x80, 0, 0x80, 2, CANFD_BRS, 0, 0, 0xaa, 0xbb, 0};
  EXPECT_EQ(std::memcmp(&raw, fd.data(), fd.size()), 0);
}

TEST(SocketCanCodec, ReadsWhatItWrites) {
  std::mt19937 random(3);
  for (int i = 0; i < 10'000; ++i) {
    Frame frame;
    frame.extended = random() % 2 != 0;
    frame.fd = random() % 2 != 0;
    frame.brs = frame.fd && random() % 2 != 0;
    frame.id = static_cast<std::uint32_t>(random()) & (frame.extended ? kLargestId : kLargestStandardId);
    frame.size = static_cast<std::uint8_t>(frame.fd ? fd_size(random() % 65) : random() % 9);
    for (std::size_t k = 0; k < frame.size; ++k) frame.data[k] = static_cast<std::uint8_t>(random());
    canfd_frame raw;
    const std::size_t size = encode(frame, raw);
    ASSERT_NE(size, 0U);
    Frame back;
    ASSERT_EQ(decode(bytes_of(raw, size), back), Kind::frame);
    EXPECT_EQ(back.id, frame.id);
    EXPECT_EQ(back.extended, frame.extended);
    EXPECT_EQ(back.fd, frame.fd);
    EXPECT_EQ(back.brs, frame.brs);
    EXPECT_EQ(back.size, frame.size);
    EXPECT_EQ(back.data, frame.data);
  }
}

TEST(SocketCanCodec, RefusesFramesThatCanDoesNotHave) {
  Frame frame;
  canfd_frame raw;
  frame.id = 0x800;
  EXPECT_EQ(encode(frame, raw), 0U);
  frame.id = 1;
  frame.size = 9;
  EXPECT_EQ(encode(frame, raw), 0U);
  frame.fd = true;
  EXPECT_EQ(encode(frame, raw), 0U);
  frame.size = 255;
  EXPECT_EQ(encode(frame, raw), 0U);
}

TEST(SocketCanCodec, ErrorFramesAreToldApartByWhatTheyTell) {
  Frame frame;
  const auto told = [&frame](canid_t what) { return decode(bytes_of(error_frame(what), CAN_MTU), frame); };
  EXPECT_EQ(told(CAN_ERR_BUSOFF), Kind::bus_off);
  EXPECT_EQ(told(CAN_ERR_RESTARTED), Kind::restarted);
  EXPECT_EQ(told(CAN_ERR_BUSOFF | CAN_ERR_RESTARTED), Kind::restarted) << "it is over";
  for (const canid_t other :
       {CAN_ERR_CRTL, CAN_ERR_ACK, CAN_ERR_LOSTARB, CAN_ERR_PROT | CAN_ERR_BUSERROR, CAN_ERR_TX_TIMEOUT})
    EXPECT_EQ(told(other), Kind::error) << other;
}

TEST(SocketCanCodec, RemoteFramesCarryNothing) {
  canfd_frame raw{};
  raw.can_id = 0x701 | CAN_RTR_FLAG;
  Frame frame;
  EXPECT_EQ(decode(bytes_of(raw, CAN_MTU), frame), Kind::remote);
}

TEST(SocketCanCodec, RefusesWhatIsNoFrameOfTheKernels) {
  Frame frame;
  canfd_frame raw{};
  raw.can_id = 0x123;
  for (std::size_t size = 0; size < sizeof raw; ++size) {
    if (size == CAN_MTU) continue;
    EXPECT_EQ(decode(bytes_of(raw, size), frame), Kind::malformed) << size;
  }
  raw.len = 9;
  EXPECT_EQ(decode(bytes_of(raw, CAN_MTU), frame), Kind::malformed);
  EXPECT_EQ(decode(bytes_of(raw, CANFD_MTU), frame), Kind::malformed);
  raw.len = 255;
  EXPECT_EQ(decode(bytes_of(raw, CANFD_MTU), frame), Kind::malformed);
  raw.len = 0;
  raw.can_id = 0x800;
  EXPECT_EQ(decode(bytes_of(raw, CAN_MTU), frame), Kind::malformed) << "eleven bits, they said";
}

TEST(SocketCanCodec, WhateverTheBytesAreAFrameIsSound) {
  std::mt19937 random(7);
  std::uint64_t frames = 0;
  for (int i = 0; i < 200'000; ++i) {
    canfd_frame raw{};
    for (std::byte& byte : std::as_writable_bytes(std::span(&raw, 1))) byte = static_cast<std::byte>(random());
    if (random() % 2 != 0) raw.len %= 9;
    Frame frame;
    if (decode(bytes_of(raw, random() % 2 != 0 ? CAN_MTU : CANFD_MTU), frame) != Kind::frame) continue;
    ASSERT_TRUE(is_can(frame));
    ++frames;
  }
  EXPECT_GT(frames, 1000U);
}

}  // namespace
}  // namespace lithe::hal::socketcan
