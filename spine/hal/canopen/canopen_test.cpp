// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/canopen/canopen.hpp"
#include "spine/core/test/units_rig.hpp"

#include <gtest/gtest.h>

#include <array>
#include <cstdint>
#include <deque>
#include <limits>
#include <random>
#include <set>
#include <string>
#include <string_view>
#include <utility>

#include "spine/hal/canopen/canopen_pdo.hpp"
#include "spine/hal/canopen/canopen_sdo.hpp"

namespace lithe::hal::canopen {
namespace {

// As `candump` writes it: 601#40001000...
std::string text(const Frame& frame) {
  constexpr std::string_view kDigits = "0123456789abcdef";
  std::string out;
  for (const int shift : {8, 4, 0}) out += kDigits[frame.id >> shift & 15];
  out += '#';
  for (const std::uint8_t byte : frame.payload()) {
    out += kDigits[byte >> 4];
    out += kDigits[byte & 15];
  }
  return out;
}

Frame frame_of(std::string_view line) {
  const auto digit = [](char c) { return static_cast<std::uint8_t>(c <= '9' ? c - '0' : c - 'a' + 10); };
  Frame frame;
  for (const char c : line.substr(0, 3)) frame.id = frame.id << 4 | digit(c);
  for (std::size_t i = 4; i + 1 < line.size(); i += 2)
    frame.data[frame.size++] = static_cast<std::uint8_t>(digit(line[i]) << 4 | digit(line[i + 1]));
  return frame;
}

// ---- Frames as the standard draws them

TEST(CanopenGolden, NetworkAndSync) {
  EXPECT_EQ(text(nmt_frame(NmtCommand::start, 5)), "000#0105");
  EXPECT_EQ(text(nmt_frame(NmtCommand::stop, 5)), "000#0205");
  EXPECT_EQ(text(nmt_frame(NmtCommand::enter_pre_operational, 0)), "000#8000");
  EXPECT_EQ(text(nmt_frame(NmtCommand::reset_node, 126)), "000#817e");
  EXPECT_EQ(text(nmt_frame(NmtCommand::reset_communication, 1)), "000#8201");
  EXPECT_EQ(text(sync_frame()), "080#");
  EXPECT_EQ(text(heartbeat_frame(127, NmtState::operational)), "77f#05");
  EXPECT_EQ(text(heartbeat_frame(1, NmtState::boot_up)), "701#00");
  EXPECT_EQ(text(emergency_frame(3, {0x8130, 0x11})), "083#3081110000000000");
}

TEST(CanopenGolden, SdoOfBothSides) {
  EXPECT_EQ(text(sdo_read_request(1, {0x1000, 0})), "601#4000100000000000");
  EXPECT_EQ(text(sdo_write_request(1, {0x6040, 0}, 0x0006, 2)), "601#2b40600006000000");
  EXPECT_EQ(text(sdo_write_request(1, {0x6060, 0}, 8, 1)), "601#2f60600008000000");
  EXPECT_EQ(text(sdo_write_request(2, {0x1016, 1}, 0x007f0064, 4)), "602#2316100164007f00");
  EXPECT_EQ(text(sdo_segment_request(1, false)), "601#6000000000000000");
  EXPECT_EQ(text(sdo_segment_request(1, true)), "601#7000000000000000");
  EXPECT_EQ(text(sdo_abort(0x581, {0x6502, 0}, abort_code::kNoObject)), "581#8002650000000206");
  EXPECT_EQ(text(sdo_read_answer(1, {0x1000, 0}, 0x00020192, 4)), "581#4300100092010200");
  EXPECT_EQ(text(sdo_read_answer(1, {0x6061, 0}, 10, 1)), "581#4f6160000a000000");
  EXPECT_EQ(text(sdo_long_answer(1, {0x1008, 0}, 9)), "581#4108100009000000");
  EXPECT_EQ(text(sdo_written_answer(1, {0x6040, 0})), "581#6040600000000000");
  const std::array<std::uint8_t, 7> letters{'a', 'b', 'c', 'd', 'e', 'f', 'g'};
  EXPECT_EQ(text(sdo_segment_answer(1, false, letters, false)), "581#0061626364656667");
  EXPECT_EQ(text(sdo_segment_answer(1, true, std::span(letters).first(2), true)), "581#1b61620000000000");
}

TEST(CanopenGolden, ProcessDataAsTheMapSays) {
  const PdoMap map{{{0x6041, 0}, 2}, {{0x6064, 0}, 4}, {{0x6077, 0}, 2}};
  EXPECT_EQ(map.bytes(), 8U);
  EXPECT_EQ(map.objects()[1].entry(), 0x60640020U);
  const std::array<std::uint32_t, 3> values{0x1237, 0xfffffffe, 0xffffff9c};
  const Frame frame = map.pack(0x181, values);
  EXPECT_EQ(text(frame), "181#3712feffffff9cff");
  std::array<std::uint32_t, 3> back{};
  ASSERT_TRUE(map.unpack(frame, back));
  EXPECT_EQ(back[0], 0x1237U);
  EXPECT_EQ(signed_of(back[1], 4), -2);
  EXPECT_EQ(signed_of(back[2], 2), -100);
  EXPECT_EQ(signed_of(0xff, 1), -1);
  EXPECT_EQ(signed_of(0x7f, 1), 127);
}

TEST(Canopen, AMapTakesNoMoreThanAFrameHolds) {
  PdoMap map{{{0x6041, 0}, 2}, {{0x6064, 0}, 4}};
  EXPECT_FALSE(map.add({{0x606c, 0}, 4}));
  EXPECT_TRUE(map.add({{0x6077, 0}, 2}));
  EXPECT_FALSE(map.add({{0x6061, 0}, 1}));
  EXPECT_EQ(map.bytes(), 8U);
  PdoMap bytes;
  for (int i = 0; i < 8; ++i) EXPECT_TRUE(bytes.add({{0x6061, 0}, 1}));
  EXPECT_FALSE(bytes.add({{0x6061, 0}, 0}));
}

TEST(Canopen, AShortFrameIsNoProcessDataAndALongOneIs) {
  const PdoMap map{{{0x606c, 0}, 4}};
  std::array<std::uint32_t, 1> value{7};
  EXPECT_FALSE(map.unpack(frame_of("281#010203"), value));
  EXPECT_EQ(value[0], 7U);
  EXPECT_TRUE(map.unpack(frame_of("281#0102030405"), value));
  EXPECT_EQ(value[0], 0x04030201U);
}

TEST(Canopen, HeartbeatsAndEmergenciesAreReadAndNothingElseIs) {
  NmtState state = NmtState::stopped;
  EXPECT_TRUE(parse_heartbeat(frame_of("705#85"), state));  // with the toggle bit of node guarding
  EXPECT_EQ(state, NmtState::operational);
  for (const char* wrong : {"705#03", "705#", "705#0505", "685#05"})
    EXPECT_FALSE(parse_heartbeat(frame_of(wrong), state)) << wrong;
  Frame extended = frame_of("705#05");
  extended.extended = true;
  EXPECT_FALSE(parse_heartbeat(extended, state));
  Emergency what;
  EXPECT_TRUE(parse_emergency(frame_of("083#1042010000000000"), what));
  EXPECT_EQ(what.code, emergency::kTooHot);
  EXPECT_EQ(what.error_register, 1);
  EXPECT_FALSE(parse_emergency(frame_of("080#1042010000000000"), what));  // that is a SYNC
  EXPECT_FALSE(parse_emergency(frame_of("083#10420100"), what));
}

TEST(Canopen, AProducerBeatsOnItsGridAndMakesNoPauseGood) {
  HeartbeatProducer producer(10 * kMs);
  EXPECT_TRUE(producer.due(100 * kMs));
  EXPECT_FALSE(producer.due(109 * kMs));
  EXPECT_TRUE(producer.due(111 * kMs));
  EXPECT_FALSE(producer.due(119 * kMs));
  EXPECT_TRUE(producer.due(120 * kMs));
  EXPECT_TRUE(producer.due(500 * kMs));
  EXPECT_FALSE(producer.due(509 * kMs));
  EXPECT_TRUE(producer.due(510 * kMs));
  producer.set_period(0);
  EXPECT_FALSE(producer.due(9'000 * kMs));
}

TEST(Canopen, AConsumerWatchesFromTheFirstBeatAndTellsALossOnce) {
  HeartbeatConsumer consumer;
  consumer.received(0);
  EXPECT_FALSE(consumer.lost(1'000 * kMs));  // it watches nobody
  consumer.set_timeout(30 * kMs);
  EXPECT_FALSE(consumer.lost(1'000 * kMs));  // nobody has beaten yet
  EXPECT_EQ(consumer.deadline_ns(), std::numeric_limits<std::int64_t>::max());
  consumer.received(1'000 * kMs);
  EXPECT_EQ(consumer.deadline_ns(), 1'030 * kMs);
  EXPECT_FALSE(consumer.lost(1'029 * kMs));
  EXPECT_TRUE(consumer.lost(1'030 * kMs));
  EXPECT_FALSE(consumer.lost(2'000 * kMs));
  consumer.received(2'000 * kMs);
  EXPECT_TRUE(consumer.lost(2'100 * kMs));
}

// ---- The SDO client

class SdoClientTest : public testing::Test {
 protected:
  // What it sends now; empty for nothing.
  std::string sends() {
    Frame frame;
    return client_.next(now_ns_, frame) ? text(frame) : "";
  }
  bool takes(std::string_view line) { return client_.on_frame(frame_of(line)); }

  SdoClient client_{1};
  std::int64_t now_ns_ = 0;
  using Outcome = SdoClient::Outcome;
};

TEST_F(SdoClientTest, ReadsAValueInOneFrameEachWay) {
  EXPECT_EQ(client_.outcome(), Outcome::idle);
  client_.read({0x1000, 0});
  EXPECT_EQ(sends(), "601#4000100000000000");
  EXPECT_EQ(sends(), "");
  EXPECT_EQ(client_.outcome(), Outcome::busy);
  EXPECT_TRUE(takes("581#4300100092010200"));
  EXPECT_EQ(client_.outcome(), Outcome::done);
  EXPECT_EQ(client_.value(), 0x00020192U);
  client_.read({0x6061, 0});
  sends();
  EXPECT_TRUE(takes("581#4f61600008ffffff"));
  EXPECT_EQ(client_.value(), 8U);  // of the one byte that counts
}

TEST_F(SdoClientTest, WritesAValueInOneFrameEachWay) {
  client_.write({0x6040, 0}, 0x0f, 2);
  EXPECT_EQ(sends(), "601#2b4060000f000000");
  EXPECT_TRUE(takes("581#6040600000000000"));
  EXPECT_EQ(client_.outcome(), Outcome::done);
}

TEST_F(SdoClientTest, ReadsATextInSegments) {
  client_.read({0x1008, 0});
  sends();
  EXPECT_TRUE(takes("581#4108100009000000"));
  EXPECT_EQ(sends(), "601#6000000000000000");
  EXPECT_TRUE(takes("581#0061626364656667"));
  EXPECT_EQ(sends(), "601#7000000000000000");
  EXPECT_TRUE(takes("581#1b68690000000000"));
  EXPECT_EQ(client_.outcome(), Outcome::done);
  EXPECT_EQ(std::string(client_.data().begin(), client_.data().end()), "abcdefghi");
}

TEST_F(SdoClientTest, AnAbortEndsItWithItsReason) {
  client_.read({0x6502, 0});
  sends();
  EXPECT_TRUE(takes("581#8002650000000206"));
  EXPECT_EQ(client_.outcome(), Outcome::failed);
  EXPECT_EQ(client_.abort(), abort_code::kNoObject);
  EXPECT_EQ(abort_name(client_.abort()), "no such object");
}

TEST_F(SdoClientTest, SilenceIsAskedThreeTimesAndEachTimeTakenBack) {
  client_.write({0x6060, 0}, 8, 1);
  for (const std::int64_t timeout_ns : SdoClient::kTimeoutsNs) {
    EXPECT_EQ(sends(), "601#2f60600008000000");
    now_ns_ += timeout_ns - 1;
    EXPECT_EQ(sends(), "");
    now_ns_ += 1;
    EXPECT_EQ(sends(), "601#8060600000000405");
  }
  EXPECT_EQ(sends(), "");
  EXPECT_EQ(client_.outcome(), Outcome::failed);
  EXPECT_EQ(client_.abort(), abort_code::kTimedOut);
}

TEST_F(SdoClientTest, AnswersToSomethingElseAreCountedAndPassedOver) {
  EXPECT_FALSE(takes("581#4300100092010200"));  // nothing was asked
  client_.read({0x1000, 0});
  sends();
  for (const char* wrong : {"581#4300100192010200",     // another subindex
                            "581#4302100092010200",     // another object
                            "581#6000100000000000",     // written, but it was to be read
                            "582#4300100092010200",     // another node
                            "581#43001000920102",       // too short
                            "581#0061626364656667"}) {  // a segment nobody asked for
    EXPECT_FALSE(takes(wrong)) << wrong;
  }
  EXPECT_EQ(client_.strays(), 7U);
  EXPECT_EQ(client_.outcome(), Outcome::busy);
  EXPECT_TRUE(takes("581#4300100092010200"));
}

TEST_F(SdoClientTest, AnAnswerThatComesTwiceIsDroppedAlsoWhileTheNextOneIsAwaited) {
  client_.write({0x6007, 0}, 3, 2);
  sends();
  EXPECT_TRUE(takes("581#6007600000000000"));
  EXPECT_FALSE(takes("581#6007600000000000"));
  client_.write({0x605a, 0}, 2, 2);
  sends();
  EXPECT_FALSE(takes("581#6007600000000000"));
  EXPECT_EQ(client_.outcome(), Outcome::busy);
  EXPECT_EQ(client_.strays(), 2U);
}

TEST_F(SdoClientTest, ASegmentThatComesTwiceIsTakenOnce) {
  client_.read({0x1008, 0});
  sends();
  EXPECT_TRUE(takes("581#4108100009000000"));
  sends();
  EXPECT_TRUE(takes("581#0061626364656667"));
  EXPECT_FALSE(takes("581#0061626364656667"));
  sends();
  EXPECT_FALSE(takes("581#0061626364656667"));
  EXPECT_TRUE(takes("581#1b68690000000000"));
  EXPECT_EQ(std::string(client_.data().begin(), client_.data().end()), "abcdefghi");
}

// A node that needs 600 ms for each answer and answers every request, aborted or not.
TEST_F(SdoClientTest, AnswersThatCome600MsLateAreEachTakenOnce) {
  constexpr std::int64_t kLateNs = 600 * kMs;
  std::deque<std::pair<std::int64_t, Frame>> coming;
  for (const std::uint16_t index : std::initializer_list<std::uint16_t>{0x1016, 0x6007, 0x605a, 0x6072}) {
    client_.write({index, 0}, 3, 2);
    while (client_.outcome() == Outcome::busy) {
      Frame sent;
      if (client_.next(now_ns_, sent) && sent.data[0] != 0x80)
        coming.emplace_back(now_ns_ + kLateNs, sdo_written_answer(1, sdo_address(sent)));
      now_ns_ += kMs;
      for (; !coming.empty() && coming.front().first <= now_ns_; coming.pop_front())
        EXPECT_EQ(client_.on_frame(coming.front().second), sdo_address(coming.front().second).index == index);
    }
    EXPECT_EQ(client_.outcome(), Outcome::done) << std::hex << index;
  }
  EXPECT_GT(client_.strays(), 0U) << "those of the second and third request";
}

TEST_F(SdoClientTest, AnAnswerAfterTheLastTimeoutIsDropped) {
  client_.read({0x6076, 0});
  for (const std::int64_t timeout_ns : SdoClient::kTimeoutsNs) {
    sends();
    now_ns_ += timeout_ns;
    EXPECT_EQ(sends(), "601#8076600000000405") << "aborted";
  }
  EXPECT_FALSE(takes("581#43766000f4010000"));
  EXPECT_EQ(client_.outcome(), Outcome::failed);
}

TEST_F(SdoClientTest, SegmentsThatNeverEndAreGivenUp) {
  client_.read({0x1008, 0});
  sends();
  takes("581#4008100000000000");  // of a length it does not say
  int segments = 0;
  for (; client_.outcome() == Outcome::busy && segments < 1000; ++segments) {
    sends();
    takes(segments % 2 == 0 ? "581#0e00000000000000" : "581#1e00000000000000");  // empty, and more to come
  }
  EXPECT_LE(segments, 70);
  EXPECT_EQ(client_.abort(), abort_code::kOutOfMemory);

  client_.read({0x1008, 0});
  sends();
  takes("581#41081000ffff0000");
  EXPECT_EQ(sends(), "601#8008100005000405");
}

TEST_F(SdoClientTest, EveryAbortHasAName) {
  const std::string_view other = abort_name(0x1234'5678);
  EXPECT_EQ(other, "a reason of the maker's own");
  std::set<std::string_view> names{other};
  for (const std::uint32_t code :
       {abort_code::kToggle, abort_code::kTimedOut, abort_code::kCommand, abort_code::kOutOfMemory,
        abort_code::kUnsupportedAccess, abort_code::kWriteOnly, abort_code::kReadOnly, abort_code::kNoObject,
        abort_code::kNotMappable, abort_code::kPdoTooLong, abort_code::kLength, abort_code::kNoSubindex,
        abort_code::kValue, abort_code::kGeneral, abort_code::kState}) {
    EXPECT_TRUE(names.insert(abort_name(code)).second) << std::hex << code << ": " << abort_name(code);
  }
}

TEST_F(SdoClientTest, NoBytesBreakIt) {
  std::mt19937 random(5);
  for (int i = 0; i < 100'000; ++i) {
    if (client_.outcome() != Outcome::busy) client_.read({0x1008, 0});
    Frame sent;
    client_.next(now_ns_, sent);
    now_ns_ += static_cast<std::int64_t>(random() % (20 * kMs));
    Frame frame = sdo_read_answer(1, {0x1008, 0}, 0, 4);
    for (std::uint8_t& byte : frame.data)
      if (random() % 2 == 0) byte = static_cast<std::uint8_t>(random());
    if (random() % 8 == 0) frame.size = static_cast<std::uint8_t>(random());
    client_.on_frame(frame);
    ASSERT_LE(client_.data().size(), SdoClient::kLongest);
  }
}

}  // namespace
}  // namespace lithe::hal::canopen
