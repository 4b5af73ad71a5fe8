// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/bus/slcan/slcan_codec.hpp"

#include <gtest/gtest.h>

#include <array>
#include <random>
#include <string>
#include <vector>

namespace lithe::hal::slcan {
namespace {

using namespace std::string_view_literals;

Frame frame_of(std::uint32_t id, bool extended, std::vector<std::uint8_t> data) {
  Frame frame;
  frame.id = id;
  frame.extended = extended;
  frame.size = static_cast<std::uint8_t>(data.size());
  std::copy(data.begin(), data.end(), frame.data.begin());
  return frame;
}

Frame fd_frame(std::uint32_t id, bool extended, bool brs, std::vector<std::uint8_t> data) {
  Frame frame = frame_of(id, extended, std::move(data));
  frame.fd = true;
  frame.brs = brs;
  return frame;
}

std::string text_of(const Frame& frame) {
  std::array<char, kLongestLine> out{};
  return {out.data(), format_frame(frame, out)};
}

void expect_same(const Frame& a, const Frame& b) {
  EXPECT_EQ(a.id, b.id);
  EXPECT_EQ(a.extended, b.extended);
  EXPECT_EQ(a.fd, b.fd);
  EXPECT_EQ(a.brs, b.brs);
  EXPECT_TRUE(std::equal(a.payload().begin(), a.payload().end(), b.payload().begin(), b.payload().end()));
}

struct Golden {
  Frame frame;
  std::string_view text;
};

// As LAWICEL's manual and the firmware of the CANable 2 write them.
const std::vector<Golden>& goldens() {
  static const std::vector<Golden> all{
      {frame_of(0x123, false, {}), "t1230\r"},
      {frame_of(0x100, false, {0x12, 0x34}), "t10021234\r"},
      {frame_of(0x7ff, false, {0, 1, 2, 3, 4, 5, 6, 0xff}), "t7FF800010203040506FF\r"},
      {frame_of(0x12abcdef, true, {0xaa}), "T12ABCDEF1AA\r"},
      {frame_of(0, true, {}), "T000000000\r"},
      {fd_frame(0x8001, true, false, {0x50}), "D00008001150\r"},
      {fd_frame(0x001, false, false, {1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12}), "d00190102030405060708090A0B0C\r"},
      {fd_frame(0x001, false, true, std::vector<std::uint8_t>(16, 0xa5)), "b001AA5A5A5A5A5A5A5A5A5A5A5A5A5A5A5A5\r"},
      {fd_frame(0x8001, true, true, {0x11, 0x00, 0x1f}), "B00008001311001F\r"},
  };
  return all;
}

TEST(SlcanCodec, WritesEveryKindOfFrameAsOthersDo) {
  for (const Golden& golden : goldens()) EXPECT_EQ(text_of(golden.frame), golden.text);
  const std::string longest = text_of(fd_frame(0x1fffffff, true, true, std::vector<std::uint8_t>(64, 1)));
  EXPECT_EQ(longest.size() + 4, kLongestLine) << "four more for the time stamp";
  EXPECT_EQ(longest[9], 'F');
}

TEST(SlcanCodec, ReadsWhatItWritesOnBothSides) {
  for (const Golden& golden : goldens()) {
    Frame frame;
    ASSERT_EQ(parse_answer(golden.text, frame), Answer::frame) << golden.text;
    expect_same(frame, golden.frame);
    Frame again;
    ASSERT_EQ(parse_request(golden.text.substr(0, golden.text.size() - 1), again), Request::send) << golden.text;
    expect_same(again, golden.frame);
  }
}

TEST(SlcanCodec, EveryLengthOfFdGoesThere) {
  std::mt19937 random(5);
  for (std::size_t size = 0; size <= kMaxPayload; ++size) {
    Frame frame = fd_frame(random() & kLargestId, true, random() % 2 != 0, std::vector<std::uint8_t>(size, 0));
    for (std::uint8_t& byte : frame.data) byte = static_cast<std::uint8_t>(random());
    const std::string text = text_of(frame);
    if (fd_size(size) != size) {
      EXPECT_EQ(text, "") << "CAN FD has no length of " << size;
      continue;
    }
    Frame back;
    ASSERT_EQ(parse_answer(text, back), Answer::frame);
    expect_same(back, frame);
  }
}

TEST(SlcanCodec, RefusesToWriteFramesThatCanDoesNotHave) {
  EXPECT_EQ(text_of(frame_of(0x800, false, {})), "");
  EXPECT_EQ(text_of(frame_of(0x20000000, true, {})), "");
  EXPECT_EQ(text_of(frame_of(1, false, std::vector<std::uint8_t>(9, 0))), "");
  EXPECT_EQ(text_of(fd_frame(1, false, false, std::vector<std::uint8_t>(9, 0))), "");
  Frame impossible = frame_of(1, false, {});
  impossible.size = 255;
  EXPECT_EQ(text_of(impossible), "");
  impossible.fd = true;
  EXPECT_EQ(text_of(impossible), "");
  Frame classic_but_fast = frame_of(1, false, {});
  classic_but_fast.brs = true;
  EXPECT_EQ(text_of(classic_but_fast), "");
}

TEST(SlcanCodec, NeverWritesBeyondTheRoomItIsGiven) {
  const Frame frame = fd_frame(0x123, false, true, std::vector<std::uint8_t>(12, 7));
  const std::size_t needed = text_of(frame).size();
  for (std::size_t room = 0; room < needed; ++room) {
    std::vector<char> out(room + 1, '#');
    EXPECT_EQ(format_frame(frame, std::span(out).first(room)), 0U);
    EXPECT_EQ(out, std::vector<char>(room + 1, '#'));
  }
}

TEST(SlcanCodec, UnderstandsWhatAnAdapterSaysBesideFrames) {
  Frame frame;
  EXPECT_EQ(parse_answer("\r", frame), Answer::done);
  EXPECT_EQ(parse_answer("\a", frame), Answer::refused);
  EXPECT_EQ(parse_answer("z\r", frame), Answer::sent);
  EXPECT_EQ(parse_answer("Z\r", frame), Answer::sent);
  EXPECT_EQ(parse_answer("t12321122ABCD\r", frame), Answer::frame) << "with a time stamp";
  EXPECT_EQ(frame.size, 2);
  EXPECT_EQ(parse_answer("r1238\r", frame), Answer::other);
  EXPECT_EQ(parse_answer("R000001238\r", frame), Answer::other);
  EXPECT_EQ(parse_answer("V1013\r", frame), Answer::other);
  EXPECT_EQ(parse_answer("b158aa5 github.com/normaldotcom/canable2-fw.git\r", frame), Answer::malformed);
  EXPECT_EQ(parse_answer("sb256000\r", frame), Answer::bus_off) << "as the kernel's driver reads it";
  EXPECT_EQ(parse_answer("sp128000\r", frame), Answer::error);
  EXPECT_EQ(parse_answer("sa000000\r", frame), Answer::other) << "healthy again";
  EXPECT_EQ(parse_answer("e1a\r", frame), Answer::error);
}

TEST(SlcanCodec, RefusesEveryLineThatIsNotWhole) {
  for (const Golden& golden : goldens()) {
    Frame frame;
    frame.id = 77;
    for (std::size_t size = 2; size + 1 < golden.text.size(); ++size) {
      std::vector<char> cut(golden.text.begin(), golden.text.begin() + size);  // what lies behind it is not ours
      EXPECT_EQ(parse_request({cut.data(), cut.size()}, frame), Request::malformed) << golden.text << size;
      cut.push_back(kDone);
      EXPECT_EQ(parse_answer({cut.data(), cut.size()}, frame), Answer::malformed) << golden.text << size;
    }
    EXPECT_EQ(frame.id, 77U) << "what is refused changes nothing";
  }
}

TEST(SlcanCodec, RefusesWhatIsNearlyRight) {
  Frame frame;
  for (const std::string_view line : {"t8000\r"sv,
                                      "T200000000\r"sv,
                                      "t1239112233445566778899\r"sv,
                                      "t12G0\r"sv,
                                      "t1230 \r"sv,
                                      "t12320G00\r"sv,
                                      "t12321\r"sv,
                                      "t123211223\r"sv,
                                      "t12321122ABC\r"sv,
                                      "t12321122ABCDE\r"sv,
                                      "t12321122ABCG\r"sv,
                                      "z0\r"sv,
                                      "x\r"sv,
                                      "\n\r"sv,
                                      "t1230"sv,
                                      ""sv,
                                      "d123G\r"sv,
                                      "r1239\r"sv,
                                      "-\r"sv,
                                      "t\0\0\0\0\r"sv}) {
    EXPECT_EQ(parse_answer(line, frame), Answer::malformed) << line;
  }
}

TEST(SlcanCodec, UnderstandsWhatAHostWants) {
  Frame frame;
  const std::vector<std::pair<std::string_view, Request>> all{
      {"S0", Request::bitrate},       {"S8", Request::bitrate},        {"S9", Request::malformed},
      {"S", Request::malformed},      {"s031C", Request::bitrate},     {"s031", Request::malformed},
      {"Y2", Request::data_bitrate},  {"Y5", Request::data_bitrate},   {"Y8", Request::malformed},
      {"O", Request::open},           {"L", Request::listen},          {"C", Request::close},
      {"V", Request::version},        {"N", Request::serial},          {"F", Request::status},
      {"Z0", Request::stamps_off},    {"Z1", Request::stamps_on},      {"Z2", Request::malformed},
      {"r1230", Request::remote},     {"R000001238", Request::remote}, {"A1", Request::other},
      {"M00000000", Request::other},  {"mFFFFFFFF", Request::other},   {"M1", Request::other},
      {"", Request::malformed},       {"O1", Request::malformed},      {"K", Request::malformed},
      {"t123011", Request::malformed}};
  for (const auto& [line, request] : all) EXPECT_EQ(parse_request(line, frame), request) << line;
}

TEST(SlcanCodec, KnowsTheBitRatesThatThereAre) {
  EXPECT_EQ(bitrate_digit(10'000), '0');
  EXPECT_EQ(bitrate_digit(500'000), '6');
  EXPECT_EQ(bitrate_digit(800'000), '7');
  EXPECT_EQ(bitrate_digit(1'000'000), '8');
  EXPECT_EQ(bitrate_digit(333'333), '\0');
  EXPECT_EQ(data_bitrate_digit(2'000'000), '2');
  EXPECT_EQ(data_bitrate_digit(5'000'000), '5');
  EXPECT_EQ(data_bitrate_digit(8'000'000), '\0');
}

// Random bytes, and sound lines with some bytes changed: whatever is taken for a frame is one, and says what the line
// says.
TEST(SlcanCodec, TakesNoNonsenseForAFrame) {
  std::mt19937 random(11);
  std::uint64_t frames = 0;
  for (int i = 0; i < 300'000; ++i) {
    std::string line(goldens()[random() % goldens().size()].text);
    for (unsigned changes = random() % 4; changes > 0; --changes) {
      line[random() % line.size()] =
          static_cast<char>(random() % 5 == 0 ? random() : "0123456789abtTdDF\r"[random() % 18]);
    }
    Frame frame;
    if (parse_answer(line, frame) != Answer::frame) continue;
    ++frames;
    ASSERT_TRUE(is_can(frame)) << line;
    std::string again = text_of(frame);
    again.pop_back();
    for (char& c : line) c = static_cast<char>(&c == line.data() ? c : std::toupper(static_cast<unsigned char>(c)));
    EXPECT_TRUE(line.starts_with(again)) << line << " became " << again;
  }
  EXPECT_GT(frames, 10'000U);
}

}  // namespace
}  // namespace lithe::hal::slcan
