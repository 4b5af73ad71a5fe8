// SPDX-License-Identifier: Apache-2.0
// What a host sees of the drive's frames: addresses, answers, errors, nonsense.
#include "spine/hal/sim/sim_moteus.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <random>
#include <vector>

#include "spine/hal/sim/test_bench.hpp"

namespace lithe::hal::sim {
namespace {

TEST(SimMoteus, IdsUpToSevenAnswerInShortFramesAndCopyTheBitRateSwitch) {
  for (const std::uint32_t id : {1U, 7U, 8U, 126U}) {
    SimMoteusParams params = bench_motor();
    params.id = id;
    Bench bench(params);
    Frame request = Bench::request({}, {reg::kPosition}, 0x8000 | id);
    auto answers = bench.send(request);
    ASSERT_EQ(answers.size(), 1U);
    EXPECT_EQ(answers[0].id, id << 8);
    EXPECT_EQ(answers[0].extended, id >= 8);
    EXPECT_TRUE(answers[0].brs && answers[0].fd);
    request.brs = false;
    request.id = 0x8000 | 5U << 8 | id;
    answers = bench.send(request);
    EXPECT_EQ(answers[0].id, id << 8 | 5);
    EXPECT_FALSE(answers[0].brs);
  }
}

TEST(SimMoteus, AClassicRequestGetsAClassicAnswerUnlessItIsTooLong) {
  Bench bench;
  Frame request = Bench::request({}, {reg::kPosition});
  request.fd = false;
  EXPECT_FALSE(bench.send(request)[0].fd);
  request = Bench::request({}, {reg::kPosition, reg::kVelocity});
  request.fd = false;
  EXPECT_TRUE(bench.send(request)[0].fd);
}

TEST(SimMoteus, WithoutTheReplyBitThereIsNoAnswerButTheCommandCounts) {
  Bench bench;
  EXPECT_TRUE(bench.send(Bench::request(kTorque, {reg::kMode}, 0x0001)).empty());
  EXPECT_EQ(bench.mode(), Mode::enabling);
}

TEST(SimMoteus, BroadcastIsForEveryoneAndOtherAddressesAndPrefixesForNobody) {
  Bench bench;
  EXPECT_EQ(bench.send(Bench::request({}, {reg::kMode}, 0x807f)).size(), 1U);
  EXPECT_TRUE(bench.send(Bench::request(kTorque, {reg::kMode}, 0x8002)).empty());
  EXPECT_TRUE(bench.send(Bench::request(kTorque, {reg::kMode}, 0x18001)).empty());
  EXPECT_EQ(bench.mode(), Mode::stopped);
}

TEST(SimMoteus, AnEmptyAnswerIsSentAsOneByteOfPadding) {
  Bench bench;
  Frame nop;
  nop.id = 0x8001;
  nop.size = 1;
  nop.data[0] = 0x50;
  auto answers = bench.send(nop);
  ASSERT_EQ(answers.size(), 1U);
  EXPECT_EQ(answers[0].size, 1);
  EXPECT_EQ(answers[0].data[0], 0x50);
  nop.data[0] = 0x44;  // flow control, which this drive does not know
  EXPECT_EQ(bench.send(nop)[0].size, 1);
}

TEST(SimMoteus, AnUnknownRegisterEndsAReadButNotAWrite) {
  Bench bench;
  Frame request;
  request.id = 0x8001;
  request.fd = true;
  SubframeWriter writer(request);
  writer.read(Format::int8, reg::kMode, 1);
  writer.write(Format::int8, 0x155, std::array{1.0});              // unknown
  writer.write(Format::float32, reg::kPosition, std::array{1.0});  // not writeable
  writer.read(Format::int8, 0x0fe, 3);                             // 0fe and 0ff are unknown
  writer.read(Format::int8, reg::kMode, 1);                        // never reached
  const Frame answer = bench.send(request)[0];
  const std::vector<std::uint8_t> expected{0x21, 0x00, 0x00, 0x30, 0xd5, 0x02, 0x01, 0x30,
                                           0x01, 0x02, 0x31, 0xfe, 0x01, 0x01, 0x50, 0x50};
  EXPECT_EQ(std::vector<std::uint8_t>(answer.payload().begin(), answer.payload().end()), expected);
}

TEST(SimMoteus, TheDefaultQueryIsAnsweredAsTheFirmwareDoes) {
  Bench bench;
  Frame request;
  request.id = 0x8001;
  request.fd = true;
  const std::array<std::uint8_t, 6> query{0x11, 0x00, 0x1f, 0x01, 0x13, 0x0d};
  std::copy(query.begin(), query.end(), request.data.begin());
  request.size = 6;
  const Frame answer = bench.send(request)[0];
  // Position 0, velocity 0, torque 0; then 24 V, 25 C, no fault, padding.
  const std::vector<std::uint8_t> expected{0x21, 0, 0, 0x2f, 1, 0,    0,  0,  0,  0, 0,    0,
                                           0,    0, 0, 0,    0, 0x23, 13, 48, 25, 0, 0x50, 0x50};
  EXPECT_EQ(std::vector<std::uint8_t>(answer.payload().begin(), answer.payload().end()), expected);
}

TEST(SimMoteus, IdentityAndStreamsAnswer) {
  Bench bench;
  const Registers r = bench.exchange({}, {reg::kFirmware, reg::kRegisterMap, reg::kId});
  EXPECT_EQ(r.at(reg::kFirmware), 0x010000);
  EXPECT_EQ(r.at(reg::kRegisterMap), 5);
  EXPECT_EQ(r.at(reg::kId), 1);
  Frame poll;
  poll.id = 0x8001;
  poll.size = 3;
  poll.data = {0x42, 0x01, 0x30};
  const Frame answer = bench.send(poll)[0];
  EXPECT_EQ(answer.size, 3);
  EXPECT_EQ(answer.data[0], 0x41);
  EXPECT_EQ(answer.data[2], 0x00);
}

TEST(SimMoteus, RandomFramesNeverBreakThePlant) {
  Bench bench;
  std::mt19937_64 random(5);
  for (int round = 0; round < 30'000; ++round) {
    Frame frame;
    frame.id = 0x8001;
    frame.size = static_cast<std::uint8_t>(random() % 65);
    for (std::uint8_t& byte : frame.data) byte = static_cast<std::uint8_t>(random());
    if (round % 3 != 0) {  // so that modes are entered and registers hit, with values of any kind
      const auto number = static_cast<std::uint8_t>(0x1c + random() % 0x2e);
      const std::array<std::uint8_t, 6> start{0x01, 0x00, static_cast<std::uint8_t>(random() % 16), 0x0c, 0x08, number};
      std::copy(start.begin(), start.end(), frame.data.begin());
      frame.size = 64;
    }
    for (const Frame& answer : bench.send(frame)) ASSERT_LE(answer.size, 64);
    bench.wait_ms(static_cast<std::int64_t>(random() % 3));
    ASSERT_TRUE(std::isfinite(bench.drive().servo().plant().position_rad()));
    ASSERT_TRUE(std::isfinite(bench.drive().servo().velocity_rev_s()));
  }
}

TEST(SimMoteus, SameFramesAtTheSameTimesGiveTheSameMotion) {
  Bench a;
  Bench b;
  for (int i = 0; i < 300; ++i) {
    const Writes command = with(kTorque, reg::kCommandTorque, 0.1 * std::sin(0.05 * i));
    EXPECT_EQ(a.exchange(command), b.exchange(command));
    a.wait_ms(1);
    b.wait_ms(1);
  }
  EXPECT_EQ(a.drive().servo().plant().position_rad(), b.drive().servo().plant().position_rad());
}

TEST(SimMoteus, TimeThatGoesBackwardsIsIgnored) {
  Bench bench;
  bench.stream(kTorque, 20);
  Servo& servo = bench.drive().servo();
  const double before = servo.plant().position_rad();
  servo.advance(0);
  servo.advance(std::numeric_limits<std::int64_t>::min() / 2);
  EXPECT_EQ(servo.plant().position_rad(), before);
}

}  // namespace
}  // namespace lithe::hal::sim
