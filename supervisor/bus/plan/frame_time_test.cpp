// SPDX-License-Identifier: Apache-2.0
#include "supervisor/bus/plan/frame_time.hpp"

#include <gtest/gtest.h>

#include <initializer_list>
#include <random>
#include <string>
#include <string_view>

namespace lithe::hal {
namespace {

Frame frame_of(std::uint32_t id, std::string_view hex, bool extended, bool fd) {
  Frame frame;
  frame.id = id;
  frame.extended = extended;
  frame.fd = frame.brs = fd;
  for (std::size_t i = 0; i + 1 < hex.size(); i += 2)
    frame.data[frame.size++] = static_cast<std::uint8_t>(std::stoi(std::string(hex.substr(i, 2)), nullptr, 16));
  return frame;
}

// As a moteus wants it: extended, with BRS, filled up with "nothing".
Frame command(std::string_view hex) {
  Frame frame = frame_of(0x8001, hex, true, true);
  const std::size_t padded = fd_size(frame.size);
  while (frame.size < padded) frame.data[frame.size++] = 0x50;
  return frame;
}

double us(const FrameBits& bits) { return 1e-3 * static_cast<double>(duration_ns(bits, {})); }
double least_us(const FrameShape& shape) { return us(least_bits(shape)); }
double most_us(const FrameShape& shape) { return us(most_bits(shape)); }

std::string text_of(const FrameImage& image) {
  std::string text;
  for (const std::uint8_t level : image.bits()) text += level != 0 ? '1' : '0';
  return text;
}

TEST(FrameTime, TheFieldsAddUpToTheKnownLengths) {
  for (std::uint32_t n = 0; n <= 8; ++n) {
    EXPECT_EQ(least_bits({n, false, false, false}).total(), 47 + 8 * n);
    EXPECT_EQ(least_bits({n, true, false, false}).total(), 67 + 8 * n);
    EXPECT_EQ(most_bits({n, false, false, false}).total(), 55 + 10 * n);
    EXPECT_EQ(most_bits({n, true, false, false}).total(), 80 + 10 * n);
  }
  EXPECT_EQ(least_bits({16, false, true, true}).nominal, 30U);
  EXPECT_EQ(least_bits({16, false, true, true}).data, 5U + 128 + 27);
  EXPECT_EQ(least_bits({20, true, true, true}).nominal, 49U);
  EXPECT_EQ(least_bits({20, true, true, true}).data, 5U + 160 + 32);
  EXPECT_EQ(least_bits({64, false, true, false}).nominal, 30U + 5 + 512 + 32);
  EXPECT_EQ(least_bits({64, false, true, false}).data, 0U);
}

// Without stuff bits, and the longest, in us at 1 and 5 Mbit/s. The longest extended ones were published one slow bit
// longer: with nine stuff bits in a head of 36, where only eight find room.
TEST(FrameTime, CanFdTakesThePublishedTimes) {
  struct Row {
    std::size_t size;
    double extended, extended_most, standard, standard_most, slow;
  };
  for (const Row& row : std::initializer_list<Row>{{8, 68, 81, 49, 57, 129},
                                                   {16, 81, 97, 62, 73, 196},
                                                   {24, 95, 114, 76, 90, 266},
                                                   {32, 108, 130, 89, 106, 335},
                                                   {48, 133, 162, 114, 138, 462},
                                                   {64, 159, 194, 140, 170, 598}}) {
    EXPECT_NEAR(least_us({row.size, true, true, true}), row.extended, 0.5);
    EXPECT_NEAR(least_us({row.size, false, true, true}), row.standard, 0.5);
    EXPECT_NEAR(most_us({row.size, true, true, true}), row.extended_most - 0.8, 0.5);
    EXPECT_NEAR(most_us({row.size, false, true, true}), row.standard_most, 0.5);
    EXPECT_GT(row.slow, least_us({row.size, false, true, false}));
    EXPECT_LT(row.slow, most_us({row.size, false, true, false}));
  }
}

TEST(FrameTime, CanopenTakesThePublishedTimes) {
  EXPECT_EQ(least_us({0, false, false, false}), 47);  // SYNC
  EXPECT_EQ(most_us({0, false, false, false}), 55);
  EXPECT_EQ(least_us({6, false, false, false}), 95);
  EXPECT_EQ(most_us({6, false, false, false}), 115);
  EXPECT_EQ(least_us({8, false, false, false}), 111);
  EXPECT_EQ(most_us({8, false, false, false}), 135);
  EXPECT_EQ(least_us({1, false, false, false}), 55);  // heartbeat
  EXPECT_EQ(most_us({1, false, false, false}), 65);
}

// With real identifiers, and any data.
double mean_us(std::uint32_t id, std::size_t size, bool extended) {
  std::mt19937 random(3);
  constexpr int kRounds = 2000;
  double sum = 0;
  for (int round = 0; round < kRounds; ++round) {
    Frame frame = frame_of(id, "", extended, true);
    frame.size = static_cast<std::uint8_t>(size);
    for (std::uint8_t& byte : frame.data) byte = static_cast<std::uint8_t>(random());
    sum += us(exact_bits(frame));
  }
  return sum / kRounds;
}

TEST(FrameTime, OnAverageMoteusFramesTakeThePublishedTimes) {
  struct Row {
    std::size_t size;
    double command, answer;
  };
  for (const Row& row : std::initializer_list<Row>{
           {8, 73, 51}, {16, 86, 63}, {24, 100, 77}, {32, 114, 93}, {48, 140, 118}, {64, 166, 144}}) {
    EXPECT_NEAR(mean_us(0x8001, row.size, true), row.command, 1) << row.size;
    EXPECT_NEAR(mean_us(0x100, row.size, false), row.answer, 2.5) << row.size;
  }
  EXPECT_NEAR(mean_us(0x800, 24, true) - mean_us(0x100, 24, false), 20, 3) << "what an id above 7 costs";
}

// Its floats are full of zeros, so that a real command needs a little more than any data would.
TEST(FrameTime, RealMoteusCommandsTakeThePublishedTimes) {
  EXPECT_NEAR(us(exact_bits(command("11001f01130d"))), 70, 1);
  EXPECT_NEAR(us(exact_bits(command("01000a0e200000c07f0000000011001f01130d"))), 95, 2);
  EXPECT_NEAR(us(exact_bits(command("01000a0c06200000803e00000000cdcccc3d0000803f0000803f0000003f0d27cdcccc3d"
                                    "11001f01130d"))),
              143, 3);
}

// Spaces are for the reader.
std::string levels(std::string text) {
  std::erase(text, ' ');
  return text;
}

TEST(FrameTime, AFrameStandsOnTheWireAsTheStandardDrawsIt) {
  const std::string text = text_of(FrameImage(frame_of(0x555, "", false, false)));
  EXPECT_EQ(text.substr(0, 20), levels("0 10101010101 0 0 0 00 1 00")) << "a stuff bit in the length";
  EXPECT_EQ(text.substr(text.size() - 13), levels("1 0 1 1111111 111"));
  const std::string fd = text_of(FrameImage(frame_of(0x555, "aa", false, true)));
  EXPECT_EQ(fd.substr(0, 30), levels("0 10101010101 0 0 10 1 0 0001 10101010"));
  EXPECT_EQ(fd.substr(30, 6), levels("1 0000 1")) << "nothing was stuffed: a count of 0, fixed stuff bits around it";
}

TEST(FrameTime, FiveZerosGetAOneAndTheStuffBitItselfCounts) {
  const FrameImage zeros(frame_of(0x000, "", false, false));  // nineteen of them, up to the end of the length
  EXPECT_EQ(text_of(zeros).substr(0, 22), levels("00000 1 00000 1 00000 1 0000"));
  const FrameImage ones(frame_of(0x07c, "", false, false));
  EXPECT_EQ(text_of(ones).substr(0, 13), levels("00000 1 1111 0 10"));
}

TEST(FrameTime, NoFrameIsShorterThanTheLeastOrLongerThanTheMost) {
  std::mt19937 random(7);
  for (int round = 0; round < 20'000; ++round) {
    Frame frame;
    frame.fd = random() % 2 == 0;
    frame.brs = random() % 2 == 0;
    frame.extended = random() % 2 == 0;
    frame.id = static_cast<std::uint32_t>(random()) & (frame.extended ? 0x1fffffffU : 0x7ffU);
    frame.size = static_cast<std::uint8_t>(frame.fd ? fd_size(random() % 65) : random() % 9);
    // Half of them of long runs, which need the most stuff bits.
    for (std::uint8_t& byte : frame.data)
      byte = static_cast<std::uint8_t>(round % 2 == 0 ? random() : random() % 2 == 0 ? 0x0f : 0x87);
    const FrameBits bits = exact_bits(frame);
    const FrameBits least = least_bits(shape_of(frame));
    const FrameBits most = most_bits(shape_of(frame));
    ASSERT_LE(least.nominal, bits.nominal);
    ASSERT_LE(least.data, bits.data);
    ASSERT_LE(bits.nominal, most.nominal);
    ASSERT_LE(bits.total(), most.total());
    ASSERT_EQ(bits.total(), least.total() + FrameImage(frame).dynamic_stuff_bits());
    ASSERT_LE(duration_ns(bits, {}), duration_ns(most, {}));
  }
}

// The data phase can need all the stuff bits that the bound allows.
TEST(FrameTime, TheBoundIsReachedButForTheHead) {
  Frame frame = frame_of(0x555, "", false, true);
  frame.size = 64;
  frame.data.fill(0x87);  // the length 1111 and a 1 need the first; from there every run of four needs another
  const FrameBits bits = exact_bits(frame);
  const FrameBits most = most_bits(shape_of(frame));
  EXPECT_LE(most.total() - bits.total(), 6U) << "the head has a stuff bit less than it could, for 0x555";
}

TEST(FrameTime, AnyBytesAreSafe) {
  std::mt19937 random(11);
  for (int round = 0; round < 20'000; ++round) {
    Frame frame;
    frame.id = static_cast<std::uint32_t>(random());
    frame.size = static_cast<std::uint8_t>(random());
    frame.extended = random() % 2 == 0;
    frame.fd = random() % 2 == 0;
    frame.brs = random() % 2 == 0;
    for (std::uint8_t& byte : frame.data) byte = round % 3 == 0 ? 0 : static_cast<std::uint8_t>(random());
    ASSERT_LE(FrameImage(frame).bits().size(), 736U);
  }
}

TEST(FrameTime, TimeIsRoundedUpAtAnyRate) {
  EXPECT_EQ(duration_ns({3, 0}, {125'000, 125'000}), 24'000);
  EXPECT_EQ(duration_ns({1, 1}, {1'000'000, 3'000'000}), 1'334);
}

}  // namespace
}  // namespace lithe::hal
