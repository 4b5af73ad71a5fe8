// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/bus/fdcanusb/fdcanusb_codec.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <optional>
#include <random>
#include <string>
#include <vector>

namespace lithe::hal::fdcanusb {
namespace {

Frame frame_of(std::uint32_t id, std::vector<std::uint8_t> data, bool extended = true, bool fd = true) {
  Frame frame;
  frame.id = id;
  frame.extended = extended;
  frame.fd = frame.brs = fd;
  frame.size = static_cast<std::uint8_t>(data.size());
  std::copy(data.begin(), data.end(), frame.data.begin());
  return frame;
}

std::string sent(const Frame& frame, bool checksum = false) {
  std::array<char, 154> out{};
  return {out.data(), format_send(frame, checksum, out)};
}

std::string received(const Frame& frame) {
  std::array<char, 153> out{};
  return {out.data(), format_received(frame, out)};
}

std::optional<Line> parsed(std::string_view line, bool want_checksum = false) {
  Line out;
  return parse_line(line, want_checksum, out) ? std::optional(out) : std::nullopt;
}

// What an adapter says to this: "" when it understands.
std::string refusal(std::string_view line) {
  Request request;
  const char* wrong = parse_request(line, {}, request);
  return wrong == nullptr ? "" : wrong;
}

Request understood(std::string_view line, const Defaults& defaults = {}) {
  Request request;
  EXPECT_EQ(parse_request(line, defaults, request), nullptr) << line;
  return request;
}

void expect_same(const Frame& a, const Frame& b) {
  EXPECT_EQ(a.id, b.id);
  EXPECT_EQ(a.extended, b.extended);
  EXPECT_EQ(a.fd, b.fd);
  EXPECT_EQ(a.brs, b.brs);
  ASSERT_EQ(a.size, b.size);
  EXPECT_TRUE(std::equal(a.data.begin(), a.data.begin() + a.size, b.data.begin()));
}

// The polynomial bit by bit, not by nibbles.
std::uint8_t slow_crc8(std::string_view text) {
  unsigned sum = 0;
  for (const char c : text) {
    sum ^= static_cast<std::uint8_t>(c);
    for (int bit = 0; bit < 8; ++bit) sum = (sum & 0x80) != 0 ? (sum << 1 ^ 0x97) & 0xff : sum << 1;
  }
  return static_cast<std::uint8_t>(sum);
}

TEST(FdcanusbSum, IsThePolynomialBitByBit) {
  std::mt19937_64 random(1);
  for (int round = 0; round < 2'000; ++round) {
    std::string text(random() % 80, ' ');
    for (char& c : text) c = static_cast<char>(random());
    ASSERT_EQ(crc8(text), slow_crc8(text));
  }
  EXPECT_EQ(crc8(""), 0);
}

TEST(FdcanusbSum, CoversTheSpaceBeforeItAndIsTakenOffWithIt) {
  std::array<char, 16> out{'O', 'K'};
  ASSERT_EQ(append_sum(out, 2), 6U);
  std::string_view line(out.data(), 6);
  EXPECT_EQ(line.substr(0, 4), "OK *");
  EXPECT_EQ(strip_sum(line), Sum::right);
  EXPECT_EQ(line, "OK");
  EXPECT_EQ(append_sum(std::span(out).first(5), 2), 0U);
}

TEST(FdcanusbSum, OneWrongCharacterIsAlwaysFound) {
  std::string whole = sent(frame_of(0x8001, {1, 2, 3, 4}), true);
  whole.pop_back();
  for (std::size_t i = 0; i + 3 < whole.size(); ++i) {
    for (int bit = 0; bit < 8; ++bit) {
      std::string broken = whole;
      broken[i] = static_cast<char>(broken[i] ^ 1 << bit);
      std::string_view line = broken;
      EXPECT_EQ(strip_sum(line), Sum::wrong);
    }
  }
}

// ---- The host's side

TEST(FdcanusbSend, SaysWhatTheMakersToolSays) {
  EXPECT_EQ(sent(frame_of(0x8001, {0x01, 0x00, 0x0a, 0x11, 0x00})), "can send 8001 01000A1100 BF\n");
  Frame plain = frame_of(0x123, {0xab}, false, false);
  EXPECT_EQ(sent(plain), "can send 0123 AB bf\n");
  plain.extended = true;
  EXPECT_EQ(sent(plain), "can ext 0123 AB bf\n");
  EXPECT_EQ(sent(frame_of(0x1fffffff, {1})), "can send 1FFFFFFF 01 BF\n");
}

TEST(FdcanusbSend, RefusesWhatCannotBeSaid) {
  EXPECT_EQ(sent(frame_of(0x8001, {})), "");
  EXPECT_EQ(sent(frame_of(0x20000000, {1})), "");
  EXPECT_EQ(sent(frame_of(0x800, {1}, false)), "");
  EXPECT_EQ(sent(frame_of(1, std::vector<std::uint8_t>(9))), "");
  EXPECT_EQ(sent(frame_of(1, std::vector<std::uint8_t>(12), true, false)), "");
  std::array<char, 153> tight{};
  const Frame longest = frame_of(0x1fffffff, std::vector<std::uint8_t>(64));
  EXPECT_EQ(format_send(longest, true, tight), 0U);
  EXPECT_EQ(sent(longest, true).size(), 154U);
}

TEST(FdcanusbLine, AReceivedFrameHasItsFlags) {
  const auto line = parsed("rcv 100 21000A2F01000000 e B F r x-1");
  ASSERT_TRUE(line);
  EXPECT_EQ(line->kind, Line::Kind::received);
  expect_same(line->frame, frame_of(0x100, {0x21, 0x00, 0x0a, 0x2f, 0x01, 0, 0, 0}, false));
  EXPECT_TRUE(parsed("rcv 0900 50 E b f r f03")->frame.extended);
  EXPECT_FALSE(parsed("rcv 0900 50 E b f r f03")->frame.fd);
}

TEST(FdcanusbLine, WithoutFlagsTheFrameTellsItself) {  // a drive's own serial port leaves them out
  const auto line = parsed("rcv 00000100 " + std::string(24, 'a'));
  ASSERT_TRUE(line);
  EXPECT_FALSE(line->frame.extended);
  EXPECT_TRUE(line->frame.fd);
  EXPECT_TRUE(parsed("rcv 0800 aa")->frame.extended);
}

TEST(FdcanusbLine, EmptyDataIsAnEmptyField) {
  const auto line = parsed("rcv 100  e B F r x-1");
  ASSERT_TRUE(line);
  EXPECT_EQ(line->frame.size, 0);
  EXPECT_TRUE(line->frame.fd);
  std::array<char, 16> out{'r', 'c', 'v', ' ', '1', '0', '0', ' '};
  const auto summed = parsed({out.data(), append_sum(out, 8)}, true);
  ASSERT_TRUE(summed);
  EXPECT_EQ(summed->frame.id, 0x100U);
  EXPECT_EQ(summed->frame.size, 0);
}

TEST(FdcanusbLine, KnowsAnswersErrorsAndOtherTalk) {
  EXPECT_EQ(parsed("OK")->kind, Line::Kind::ok);
  EXPECT_EQ(parsed("ERR unknown flag")->kind, Line::Kind::error);
  EXPECT_EQ(parsed("ERR unknown flag")->text, "unknown flag");
  EXPECT_EQ(parsed("ERR")->text, "");
  EXPECT_EQ(parsed("lec=0 dlec=0 err=0")->kind, Line::Kind::other);
  EXPECT_EQ(parsed("OKAY")->kind, Line::Kind::other);
  EXPECT_EQ(parsed("")->kind, Line::Kind::other);
  EXPECT_EQ(parsed("rcv 100  e b f R x-1")->kind, Line::Kind::other);
}

TEST(FdcanusbLine, RefusesNonsense) {
  for (const char* line :
       {"rcv ", "rcv 100", "rcv x00 11 e", "rcv 100 1 e", "rcv 100 1g e", "rcv 123456789 11", "rcv 20000000 11",
        "rcv 800 11 e b f r", "rcv 100 111111111111111111 E B F r", "rcv 100 111111111111111111111111 E b f r"}) {
    EXPECT_FALSE(parsed(line)) << line;
  }
  EXPECT_FALSE(parsed("rcv 100 " + std::string(130, '0') + " E B F r"));
  EXPECT_FALSE(parsed(std::string(kLongestLine + 1, 'x')));
}

TEST(FdcanusbLine, AChecksumIsHeldWhenThereIsOneAndDemandedWhenWanted) {
  EXPECT_FALSE(parsed("OK", true));
  EXPECT_FALSE(parsed("OK *00"));
  std::array<char, 8> out{'O', 'K'};
  const std::string_view good(out.data(), append_sum(out, 2));
  EXPECT_EQ(parsed(good)->kind, Line::Kind::ok);
  EXPECT_EQ(parsed(good, true)->kind, Line::Kind::ok);
}

// ---- The adapter's side

TEST(FdcanusbRequest, TakesWhatClientsSend) {
  const Frame expected = frame_of(0x8001, {0x11, 0x00, 0x1f, 0x01, 0x13, 0x0d});
  for (const char* line :
       {"can send 8001 11001F01130D BF", "can send 8001 11001f01130d", "can ext 00008001 11001F01130d"}) {
    const Request request = understood(line);
    EXPECT_EQ(request.kind, Request::Kind::send);
    expect_same(request.frame, expected);
  }
  EXPECT_FALSE(understood("can send 8001 1100 bF").frame.brs);
  EXPECT_FALSE(understood("can send 123 1100").frame.extended);
  EXPECT_TRUE(understood("can ext 123 1100").frame.extended);
  EXPECT_FALSE(understood("can std 123 1100 f").frame.brs);
  EXPECT_FALSE(understood("can send 123 1100", {false, false}).frame.fd);
  EXPECT_EQ(understood("can send 123 00 R").kind, Request::Kind::remote);
}

TEST(FdcanusbRequest, FillsUpToALengthThatCanHas) {
  const Request request = understood("can send 8001 010203040506070809");
  EXPECT_EQ(request.frame.size, 12);
  EXPECT_EQ(request.frame.data[8], 9);
  EXPECT_EQ(request.frame.data[9], 0);
}

TEST(FdcanusbRequest, KnowsTheOtherCommands) {
  EXPECT_EQ(understood("can on").kind, Request::Kind::on);
  EXPECT_EQ(understood("can off").kind, Request::Kind::off);
  EXPECT_EQ(understood("can status").kind, Request::Kind::status);
  EXPECT_EQ(understood("can config").kind, Request::Kind::config);
  EXPECT_EQ(understood("conf get can.bitrate").text, "get can.bitrate");
  EXPECT_EQ(understood("").kind, Request::Kind::nothing);
  EXPECT_EQ(understood("   ").kind, Request::Kind::nothing);
}

TEST(FdcanusbRequest, RefusesInTheFirmwaresWords) {
  const std::pair<std::string, const char*> cases[] = {
      {"hello", "unknown command"},
      {"can", "unknown subcommand"},
      {"can jump", "unknown subcommand"},
      {"can send", "insufficient options"},
      {"can send 8001", "insufficient options"},
      {"can send 8001 11 B F", "unknown flag"},
      {"can send 8001 11 x", "unknown flag"},
      {"can send 20000000 11", "bad id"},
      {"can send zz 11", "bad id"},
      {"can std 8001 11", "bad id"},
      {"can send 8001 111", "data invalid length"},
      {"can send 8001 " + std::string(130, '0'), "data invalid length"},
      {"can send 8001 " + std::string(18, '0') + " f", "data invalid length"},
      {"can send 8001 1g", "invalid data"},
      {std::string(kLongestLine + 1, 'c'), "unknown command"},
  };
  for (const auto& [line, words] : cases) EXPECT_EQ(refusal(line), words) << line;
}

TEST(FdcanusbReceived, WritesWholeBytesAndCapitals) {
  EXPECT_EQ(received(frame_of(0x100, {0x21, 0x0a}, false)), "rcv 0100 210A e B F r x-1");
  EXPECT_EQ(received(frame_of(0x0f, {1}, false, false)), "rcv 0F 01 e b f r x-1");
  EXPECT_EQ(received(frame_of(0x18001, {1})), "rcv 018001 01 E B F r x-1");
  EXPECT_EQ(received(frame_of(0x900, {})), "rcv 0900  E B F r x-1");
  EXPECT_EQ(received(frame_of(0x1fffffff, std::vector<std::uint8_t>(64))).size(), 153U);
  std::array<char, 20> tight{};
  EXPECT_EQ(format_received(frame_of(1, std::vector<std::uint8_t>(64)), tight), 0U);
}

TEST(FdcanusbBothSides, EveryFrameComesThroughBothWays) {
  std::mt19937_64 random(3);
  constexpr std::array<std::size_t, 15> kSizes{1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64};
  for (int round = 0; round < 3'000; ++round) {
    Frame frame;
    frame.extended = random() % 2 == 0;
    frame.id = static_cast<std::uint32_t>(random() % (frame.extended ? 0x20000000 : 0x800));
    frame.size = static_cast<std::uint8_t>(kSizes[random() % kSizes.size()]);
    frame.fd = frame.size > 8 || random() % 2 == 0;
    frame.brs = frame.fd && random() % 2 == 0;
    for (std::size_t i = 0; i < frame.size; ++i) frame.data[i] = static_cast<std::uint8_t>(random());
    std::string line = sent(frame, round % 2 == 0);
    line.pop_back();
    std::string_view rest = line;
    EXPECT_EQ(strip_sum(rest), round % 2 == 0 ? Sum::right : Sum::absent);
    expect_same(understood(rest).frame, frame);
    expect_same(parsed(received(frame))->frame, frame);
  }
}

TEST(FdcanusbBothSides, GarbageAndTruncationNeverBreakAnything) {
  std::mt19937_64 random(4);
  const std::string seeds[] = {"rcv 0100 210A e B F r x-1", "can send 8001 11001F01130D BF *55", "ERR unknown flag",
                               "OK"};
  constexpr std::string_view kLetters = "0123456789abcdefABCDEF rcvxOKE*-\0\xff";
  for (int round = 0; round < 100'000; ++round) {
    std::string line = seeds[random() % 4];
    for (std::size_t i = random() % 4; i > 0; --i) line[random() % line.size()] = kLetters[random() % kLetters.size()];
    line.resize(random() % 2 == 0 ? line.size() : random() % (line.size() + 1));
    Line out;
    if (parse_line(line, false, out) && out.kind == Line::Kind::received) {
      ASSERT_LE(out.frame.size, kMaxPayload);
      ASSERT_LE(out.frame.id, 0x1fffffffU);
    }
    Request request;
    parse_request(line, {}, request);
    ASSERT_LE(request.frame.size, kMaxPayload);
  }
}

}  // namespace
}  // namespace lithe::hal::fdcanusb
