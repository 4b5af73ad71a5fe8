// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/moteus/moteus_codec.hpp"
#include "spine/core/test/units_rig.hpp"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <limits>
#include <random>
#include <string>
#include <string_view>
#include <vector>

namespace lithe::hal::moteus::codec_test {
namespace {

using List = std::vector<double>;

std::string hex(const Frame& frame) {
  std::string text;
  for (const std::uint8_t byte : frame.payload()) {
    text += "0123456789abcdef"[byte >> 4];
    text += "0123456789abcdef"[byte & 15];
  }
  return text;
}

std::vector<std::uint8_t> bytes(std::string_view text) {
  std::vector<std::uint8_t> out;
  for (std::size_t i = 0; i + 1 < text.size(); i += 2)
    out.push_back(static_cast<std::uint8_t>(std::stoi(std::string(text.substr(i, 2)), nullptr, 16)));
  return out;
}

void default_query(SubframeWriter& writer) {
  writer.read(Format::int8, reg::kMode, 1);
  writer.read(Format::float32, reg::kPosition, 3);
  writer.read(Format::int8, reg::kVoltage, 3);
}

void set_mode(SubframeWriter& writer, Mode mode) { writer.write(Format::int8, reg::kMode, List{double(mode)}); }

double round_trip(double value, Quantity quantity, Format format) {
  std::array<std::uint8_t, 4> raw{};
  encode_value(value, quantity, format, raw.data());
  return decode_value(raw.data(), quantity, format);
}

// ---- Frames that the maker's own library sends

TEST(MoteusGolden, Query) {
  Frame frame;
  SubframeWriter writer(frame);
  default_query(writer);
  EXPECT_EQ(hex(frame), "11001f01130d");
}

TEST(MoteusGolden, StopAndQuery) {
  Frame frame;
  SubframeWriter writer(frame);
  set_mode(writer, Mode::stopped);
  default_query(writer);
  EXPECT_EQ(hex(frame), "01000011001f01130d");
}

TEST(MoteusGolden, PositionNanVelocityZero) {
  Frame frame;
  SubframeWriter writer(frame);
  set_mode(writer, Mode::position);
  writer.write(Format::float32, reg::kCommandPosition, List{kNan, 0});
  default_query(writer);
  EXPECT_EQ(hex(frame), "01000a0e200000c07f0000000011001f01130d");
}

TEST(MoteusGolden, FullPositionCommandIsPaddedTo48Bytes) {
  Frame frame;
  SubframeWriter writer(frame);
  set_mode(writer, Mode::position);
  writer.write(Format::float32, reg::kCommandPosition, List{.25, 0, .1, 1, 1, .5});
  writer.write(Format::float32, reg::kWatchdog, List{.1});
  default_query(writer);
  EXPECT_EQ(hex(frame), "01000a0c06200000803e00000000cdcccc3d0000803f0000803f0000003f0d27cdcccc3d11001f01130d");
  EXPECT_EQ(frame.size, 42);
  writer.pad();
  EXPECT_EQ(frame.size, 48);
  EXPECT_EQ(hex(frame).substr(84), "505050505050");
  EXPECT_TRUE(writer.ok());
}

TEST(MoteusGolden, BrakeAndZeroVelocity) {
  Frame frame;
  SubframeWriter brake(frame);
  set_mode(brake, Mode::brake);
  EXPECT_EQ(hex(frame), "01000f");
  SubframeWriter zero(frame);
  set_mode(zero, Mode::zero_velocity);
  EXPECT_EQ(hex(frame), "01000c");
}

TEST(MoteusGolden, TheFullCommandReadsBack) {
  const auto raw = bytes("01000a0c06200000803e00000000cdcccc3d0000803f0000803f0000003f0d27cdcccc3d11001f01130d5050");
  SubframeReader reader(raw);
  Subframe s;
  ASSERT_TRUE(reader.next(s));
  EXPECT_EQ(s.kind, Kind::write);
  EXPECT_EQ(s.start, reg::kMode);
  EXPECT_EQ(s.value(0), 10);
  ASSERT_TRUE(reader.next(s));
  ASSERT_EQ(s.count, 6U);
  EXPECT_EQ(s.start, reg::kCommandPosition);
  const std::array<float, 6> expected{.25F, 0, .1F, 1, 1, .5F};
  for (std::uint32_t i = 0; i < 6; ++i) EXPECT_EQ(s.value(i), expected[i]);
  ASSERT_TRUE(reader.next(s));
  EXPECT_EQ(s.start, reg::kWatchdog);
  EXPECT_EQ(s.value(0), .1F);
  for (const std::uint32_t count : {1U, 3U, 3U}) {
    ASSERT_TRUE(reader.next(s));
    EXPECT_EQ(s.kind, Kind::read);
    EXPECT_EQ(s.count, count);
  }
  EXPECT_FALSE(reader.next(s));
  EXPECT_TRUE(reader.well_formed());
}

TEST(MoteusGolden, TheDefaultReplyReadsBack) {
  // mode 10 | 0.5 rev, -1.5 rev/s, 0.125 Nm | 24 V, 25 C, no fault
  const auto raw = bytes("21000a2f010000003f0000c0bf0000003e230d301900");
  EXPECT_EQ(raw.size(), 22U);
  SubframeReader reader(raw);
  Subframe s;
  ASSERT_TRUE(reader.next(s));
  EXPECT_EQ(s.kind, Kind::reply);
  EXPECT_EQ(s.value(0), 10);
  ASSERT_TRUE(reader.next(s));
  EXPECT_EQ(s.value(0), 0.5);
  EXPECT_EQ(s.value(1), -1.5);
  EXPECT_EQ(s.value(2), 0.125);
  ASSERT_TRUE(reader.next(s));
  EXPECT_EQ(s.start, reg::kVoltage);
  EXPECT_EQ(s.value(0), 24);
  EXPECT_EQ(s.value(1), 25);
  EXPECT_EQ(s.value(2), 0);
  EXPECT_FALSE(reader.next(s));
  EXPECT_TRUE(reader.well_formed());

  Frame frame;
  SubframeWriter writer(frame);
  writer.reply(Format::int8, reg::kMode, List{10}, false);
  writer.reply(Format::float32, reg::kPosition, List{.5, -1.5, .125}, false);
  writer.reply(Format::int8, reg::kVoltage, List{24, 25, 0}, false);
  EXPECT_EQ(hex(frame), "21000a2f010000003f0000c0bf0000003e230d301900");
}

TEST(MoteusGolden, StreamSubframesReadBack) {
  const auto raw = bytes("400107642073746f700a420130");  // "d stop\n" on channel 1, then a poll for 48 bytes
  SubframeReader reader(raw);
  Subframe s;
  ASSERT_TRUE(reader.next(s));
  EXPECT_EQ(s.kind, Kind::client_data);
  EXPECT_EQ(s.start, 1U);
  EXPECT_EQ(std::string(reinterpret_cast<const char*>(s.data), s.count), "d stop\n");
  ASSERT_TRUE(reader.next(s));
  EXPECT_EQ(s.kind, Kind::poll);
  EXPECT_EQ(s.count, 48U);
  EXPECT_FALSE(reader.next(s));
  EXPECT_TRUE(reader.well_formed());
}

TEST(MoteusGolden, DiscoveryReadsBack) {
  const auto raw = bytes("1804d00211d802");
  SubframeReader reader(raw);
  Subframe s;
  ASSERT_TRUE(reader.next(s));
  EXPECT_EQ(s.kind, Kind::read);
  EXPECT_EQ(s.format, Format::int32);
  EXPECT_EQ(s.start, 0x150U);
  EXPECT_EQ(s.count, 4U);
  ASSERT_TRUE(reader.next(s));
  EXPECT_EQ(s.start, 0x158U);
  EXPECT_EQ(s.count, 1U);
  Frame frame;
  SubframeWriter writer(frame);
  writer.read(Format::int32, 0x150, 4);
  writer.read(Format::int8, 0x158, 1);
  EXPECT_EQ(hex(frame), "1804d00211d802");
}

TEST(MoteusGolden, ErrorsReadBack) {
  Frame frame;
  SubframeWriter writer(frame);
  writer.error(Kind::write_error, 0x155, 2);
  writer.error(Kind::read_error, 0x0ff, 1);
  EXPECT_EQ(hex(frame), "30d5020231ff0101");
  SubframeReader reader(frame.payload());
  Subframe s;
  ASSERT_TRUE(reader.next(s));
  EXPECT_EQ(s.kind, Kind::write_error);
  EXPECT_EQ(s.start, 0x155U);
  EXPECT_EQ(s.error, 2U);
  ASSERT_TRUE(reader.next(s));
  EXPECT_EQ(s.kind, Kind::read_error);
  EXPECT_EQ(s.error, 1U);
}

// ---- Values

struct Worth {
  Quantity quantity;
  double int8, int16, int32;
};
constexpr Worth kWorths[] = {
    {Quantity::position_rev, 0.01, 0.0001, 0.00001},
    {Quantity::velocity_rev_s, 0.1, 0.00025, 0.00001},
    {Quantity::acceleration_rev_s2, 0.05, 0.001, 0.00001},
    {Quantity::torque_nm, 0.5, 0.01, 0.001},
    {Quantity::fraction, 1.0 / 127, 1.0 / 32767, 1.0 / 2147483647},
    {Quantity::voltage_v, 0.5, 0.1, 0.001},
    {Quantity::temperature_c, 1, 0.1, 0.001},
    {Quantity::current_a, 1, 0.1, 0.001},
    {Quantity::time_s, 0.01, 0.001, 1e-6},
    {Quantity::power_w, 10, 0.05, 0.0001},
    {Quantity::integer, 1, 1, 1},
};

TEST(MoteusValues, OneCountIsWorthWhatTheProtocolSays) {
  for (const Worth& w : kWorths) {
    EXPECT_EQ(count_worth(w.quantity, Format::int8), w.int8);
    EXPECT_EQ(count_worth(w.quantity, Format::int16), w.int16);
    EXPECT_EQ(count_worth(w.quantity, Format::int32), w.int32);
    EXPECT_EQ(count_worth(w.quantity, Format::float32), 1);
    std::array<std::uint8_t, 4> raw{1, 0, 0, 0};
    EXPECT_EQ(decode_value(raw.data(), w.quantity, Format::int8), w.int8);
    EXPECT_EQ(decode_value(raw.data(), w.quantity, Format::int16), w.int16);
    EXPECT_EQ(decode_value(raw.data(), w.quantity, Format::int32), w.int32);
  }
}

TEST(MoteusValues, ComeBackWithinOneCountAndNeverFartherFromZero) {
  std::mt19937_64 random(1);
  for (const Worth& w : kWorths) {
    for (const Format format : {Format::int8, Format::int16, Format::int32}) {
      const double worth = count_worth(w.quantity, format);
      const double largest = worth * (format == Format::int8 ? 127 : format == Format::int16 ? 32767 : 2147483647);
      std::uniform_real_distribution<double> any(-largest, largest);
      for (int i = 0; i < 1000; ++i) {
        const double value = any(random);
        const double back = round_trip(value, w.quantity, format);
        EXPECT_LE(std::abs(back - value), worth * (1 + 1e-9));
        EXPECT_LE(std::abs(back), std::abs(value) * (1 + 1e-9));
      }
    }
  }
}

TEST(MoteusValues, SaturateInsteadOfWrapping) {
  for (const double huge : {1e6, 1e300}) {
    EXPECT_NEAR(round_trip(huge, Quantity::position_rev, Format::int8), 1.27, 1e-12);
    EXPECT_NEAR(round_trip(-huge, Quantity::position_rev, Format::int8), -1.27, 1e-12);
    EXPECT_NEAR(round_trip(huge, Quantity::position_rev, Format::int16), 3.2767, 1e-12);
    EXPECT_NEAR(round_trip(-huge, Quantity::position_rev, Format::int16), -3.2767, 1e-12);
    EXPECT_NEAR(round_trip(huge, Quantity::position_rev, Format::int32), 21474.83647, 1e-9);
    EXPECT_NEAR(round_trip(-huge, Quantity::position_rev, Format::int32), -21474.83647, 1e-9);
  }
}

TEST(MoteusValues, WhatIsNotFiniteIsTheSmallestInteger) {
  std::array<std::uint8_t, 4> raw{};
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  for (const double value : {kNan, kInfinity, -kInfinity}) {
    encode_value(value, Quantity::position_rev, Format::int8, raw.data());
    EXPECT_EQ(raw[0], 0x80);
  }
  encode_value(kNan, Quantity::position_rev, Format::int16, raw.data());
  EXPECT_EQ(raw[0], 0x00);
  EXPECT_EQ(raw[1], 0x80);
  encode_value(kNan, Quantity::position_rev, Format::int32, raw.data());
  EXPECT_EQ(raw[3], 0x80);
  for (const Format format : {Format::int8, Format::int16, Format::int32, Format::float32})
    EXPECT_TRUE(std::isnan(round_trip(kNan, Quantity::velocity_rev_s, format)));
}

TEST(MoteusValues, EveryCommandRegisterHasItsQuantity) {
  using enum Quantity;
  const Quantity expected[] = {position_rev, velocity_rev_s, torque_nm, fraction,       fraction,
                               torque_nm,    position_rev,   time_s,    velocity_rev_s, acceleration_rev_s2,
                               voltage_v,    fraction,       current_a, integer};
  for (std::uint32_t i = 0; i < std::size(expected); ++i) EXPECT_EQ(quantity_of(0x020 + i), expected[i]) << i;
  const Quantity within[] = {position_rev, position_rev, torque_nm, fraction, fraction,
                             torque_nm,    time_s,       fraction,  integer};
  for (std::uint32_t i = 0; i < std::size(within); ++i) EXPECT_EQ(quantity_of(0x040 + i), within[i]) << i;
}

// ---- Any bytes

TEST(MoteusBytes, AVaruintIsReadToFiveBytesAndNoFarther) {
  Subframe s;
  const auto largest = bytes("11ffffffff0f");
  SubframeReader good(largest);
  ASSERT_TRUE(good.next(s));
  EXPECT_EQ(s.start, 0xffffffffU);
  for (const char* text : {"11ffffffff1f", "11ffffffffff01", "11ff", "11"}) {
    const auto raw = bytes(text);
    SubframeReader bad(raw);
    EXPECT_FALSE(bad.next(s)) << text;
    EXPECT_FALSE(bad.well_formed()) << text;
  }
}

TEST(MoteusBytes, AnUnknownSubframeEndsTheReading) {
  const auto raw = bytes("11006011001100");
  SubframeReader reader(raw);
  Subframe s;
  EXPECT_TRUE(reader.next(s));
  EXPECT_FALSE(reader.next(s));
  EXPECT_FALSE(reader.well_formed());
  EXPECT_FALSE(reader.next(s));
}

TEST(MoteusBytes, ACountThatClaimsMoreThanThereIsIsRefused) {
  for (const char* text : {"0c06200000803e", "0cffffffff0f20", "0c8080808004200000", "2f0100000000", "400164ff"}) {
    const auto raw = bytes(text);
    SubframeReader reader(raw);
    Subframe s;
    EXPECT_FALSE(reader.next(s)) << text;
    EXPECT_FALSE(reader.well_formed()) << text;
  }
}

TEST(MoteusBytes, RandomBytesNeverLeadOutsideThePayload) {
  std::mt19937_64 random(7);
  std::uint64_t values = 0;
  for (int round = 0; round < 200'000; ++round) {
    // On the heap and exactly as long as needed, so that AddressSanitizer sees a step too far.
    std::vector<std::uint8_t> raw(random() % 65);
    for (std::uint8_t& byte : raw) byte = static_cast<std::uint8_t>(random() & (round % 2 == 0 ? 0xff : 0x3f));
    SubframeReader reader(raw);
    Subframe s;
    std::size_t subframes = 0;
    while (reader.next(s)) {
      ASSERT_LE(++subframes, raw.size());
      const bool stream = s.kind == Kind::client_data || s.kind == Kind::server_data;
      const bool has_values = s.kind == Kind::write || s.kind == Kind::reply;
      if (!stream && !has_values) continue;
      const std::size_t size = stream ? s.count : s.count * bytes_of(s.format);
      ASSERT_GE(s.data, raw.data());
      ASSERT_LE(s.data + size, raw.data() + raw.size());
      for (std::uint32_t i = 0; has_values && i < s.count; ++i) values += std::isnan(s.value(i)) ? 1 : 0;
    }
  }
  EXPECT_GT(values, 0U);
}

TEST(MoteusBytes, RandomSubframesRoundTrip) {
  std::mt19937_64 random(11);
  for (int round = 0; round < 20'000; ++round) {
    Frame frame;
    SubframeWriter writer(frame);
    const auto format = static_cast<Format>(random() & 3);
    const auto start = static_cast<std::uint32_t>(random() & 0x1ff);
    List list(random() % 8);
    for (double& value : list)
      value = static_cast<std::int8_t>(random()) * count_worth(quantity_of(start), format) * 0.9;
    const bool reply = (random() & 1) != 0;
    reply ? writer.reply(format, start, list, (random() & 1) != 0) : writer.write(format, start, list);
    ASSERT_TRUE(writer.ok());
    writer.pad();
    SubframeReader reader(frame.payload());
    Subframe s;
    ASSERT_TRUE(reader.next(s));
    EXPECT_EQ(s.kind, reply ? Kind::reply : Kind::write);
    EXPECT_EQ(s.start, start);
    ASSERT_EQ(s.count, list.size());
    for (std::uint32_t i = 0; i < s.count; ++i) {
      const double expected = round_trip(list[i], quantity_of(start + i), format);
      EXPECT_EQ(s.value(i), expected);
    }
    EXPECT_FALSE(reader.next(s));
    EXPECT_TRUE(reader.well_formed());
  }
}

TEST(MoteusBytes, ASubframeThatDoesNotFitIsLeftOutWhole) {
  Frame frame;
  SubframeWriter writer(frame);
  writer.write(Format::float32, reg::kCommandPosition, List(14, 1.0));
  EXPECT_EQ(frame.size, 59);
  writer.write(Format::float32, reg::kMode, List{1});
  EXPECT_EQ(frame.size, 59);
  EXPECT_FALSE(writer.ok());
  writer.pad();
  EXPECT_EQ(frame.size, 64);
}

}  // namespace
}  // namespace lithe::hal::moteus::codec_test
