// SPDX-License-Identifier: Apache-2.0
// What a host sees of the drive's frames: addresses, answers, errors, nonsense.
#include "spine/hal/moteus/sim/sim_moteus.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <random>
#include <vector>

#include "spine/hal/moteus/test/sim_rig.hpp"

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
  nop.data[0] = 0x77;  // nobody knows this one
  EXPECT_EQ(bench.send(nop)[0].size, 1);
}

TEST(SimMoteus, FlowControlIsMetWithSilence) {
  Bench bench;
  for (const int head : {0x43, 0x44}) {
    Frame frame;
    frame.id = 0x8001;
    frame.size = 4;
    frame.data = {static_cast<std::uint8_t>(head), 1, 0, 48};
    EXPECT_TRUE(bench.send(frame).empty());
  }
}

TEST(SimMoteus, AnUnknownRegisterEndsAReadButNotAWrite) {
  Bench bench;
  Frame request;
  request.id = 0x8001;
  request.fd = true;
  SubframeWriter writer(request);
  writer.read(Format::int8, reg::kMode, 1);
  writer.write(Format::int8, 0x15f, std::array{1.0});              // unknown
  writer.write(Format::float32, reg::kPosition, std::array{1.0});  // not writeable
  writer.read(Format::int8, 0x0fe, 3);                             // 0fe and 0ff are unknown
  writer.read(Format::int8, reg::kMode, 1);                        // never reached
  const Frame answer = bench.send(request)[0];
  const std::vector<std::uint8_t> expected{0x21, 0x00, 0x00, 0x30, 0xdf, 0x02, 0x01, 0x30,
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

// One register as int32; NaN when the drive has no such register.
double word(Bench& bench, std::uint32_t number, Format format = Format::int32) {
  Frame request;
  request.id = 0x8001;
  request.fd = true;
  SubframeWriter writer(request);
  writer.read(format, number, 1);
  const Frame answer = bench.send(request)[0];
  SubframeReader reader(answer.payload());
  Subframe s;
  return reader.next(s) && s.kind == Kind::reply ? s.value(0) : kNan;
}

TEST(SimMoteus, SaysWhoItIsInWholeWordsOnly) {
  Bench bench;
  EXPECT_EQ(word(bench, reg::kModel), 0);
  EXPECT_EQ(word(bench, reg::kFirmware), 0x010000);
  EXPECT_EQ(word(bench, reg::kRegisterMap), 5);
  EXPECT_EQ(word(bench, reg::kId), 1);
  EXPECT_NE(word(bench, reg::kSerial), word(bench, reg::kSerial + 1));
  EXPECT_TRUE(std::isnan(word(bench, reg::kFirmware, Format::int16)));
  EXPECT_EQ(word(bench, reg::kUuidMaskCapable, Format::int8), 1);
  for (std::uint32_t i = 0; i < 4; ++i) {
    EXPECT_EQ(word(bench, reg::kUuid + i), MoteusIdentity::of(0).uuid_word(i));
    EXPECT_TRUE(std::isnan(word(bench, reg::kUuidMask + i)));
  }
}

TEST(SimMoteus, AnothersUuidMaskSilencesTheFrameAndItsCommand) {
  Bench bench;
  for (const bool own : {false, true}) {
    Frame request;
    request.id = 0x807f;
    request.extended = request.fd = true;
    SubframeWriter writer(request);
    writer.write(Format::int8, reg::kMode, std::array{10.0});
    writer.write(Format::int32, reg::kUuidMask, std::array{MoteusIdentity::of(0).uuid_word(0) + (own ? 0.0 : 1.0)});
    writer.read(Format::int8, reg::kMode, 1);
    writer.pad();
    EXPECT_EQ(bench.send(request).size(), own ? 1U : 0U);
    EXPECT_EQ(bench.mode(), own ? Mode::enabling : Mode::stopped);
  }
}

TEST(SimMoteus, TwoDevicesDiffer) {
  EXPECT_NE(MoteusIdentity::of(1).uuid, MoteusIdentity::of(2).uuid);
  EXPECT_NE(MoteusIdentity::of(1).serial, MoteusIdentity::of(2).serial);
  EXPECT_EQ(MoteusIdentity::of(3).uuid, MoteusIdentity::of(3).uuid);
}

TEST(SimMoteus, InjectedFaultsBeginAndEnd) {
  Bench bench;
  bench.stream(kTorque, 20);
  EXPECT_TRUE(bench.drive().inject(InjectedFault::over_temperature, true, 0));
  EXPECT_EQ(bench.stream(kTorque, 2).at(reg::kFault), moteus::fault::kOverTemperature);
  bench.drive().inject(InjectedFault::over_temperature, false, 0);
  bench.stream(kStop, 2);
  EXPECT_EQ(bench.stream(kTorque, 20).at(reg::kMode), 10);
  EXPECT_TRUE(bench.drive().inject(InjectedFault::encoder_lost, true, 0));
  EXPECT_EQ(bench.stream(kTorque, 2).at(reg::kFault), moteus::fault::kEncoder);
  bench.drive().inject(InjectedFault::encoder_lost, false, 0);
  EXPECT_TRUE(bench.drive().inject(InjectedFault::power_loss, true, 1'000 * kMs));
  bench.wait_ms(100);
  EXPECT_EQ(bench.mode(), Mode::stopped);
}

TEST(SimMoteus, EveryRegisterOfTheMapIsThere) {
  Bench bench;
  const std::pair<std::uint32_t, std::uint32_t> spans[] = {
      {0x000, 0x007}, {0x00a, 0x00f}, {0x01c, 0x01d}, {0x020, 0x02d}, {0x030, 0x034}, {0x038, 0x03d}, {0x040, 0x048},
      {0x050, 0x055}, {0x058, 0x058}, {0x05c, 0x064}, {0x068, 0x06c}, {0x070, 0x07f}, {0x140, 0x141}};
  for (const auto& [first, last] : spans)
    for (std::uint32_t number = first; number <= last; ++number)
      EXPECT_EQ(bench.exchange({}, {number}).count(number), 1U) << number;
  for (const std::uint32_t number : {0x008U, 0x009U, 0x035U, 0x049U, 0x056U, 0x059U, 0x065U, 0x06dU, 0x103U, 0x159U})
    EXPECT_EQ(bench.exchange({}, {number}).count(number), 0U) << number;
}

TEST(SimMoteus, OutputsAreKeptAndInputsFollowThem) {
  Bench bench;
  bench.exchange({{reg::kAuxGpioCommand, 5}, {reg::kAuxPwm + 3, 0.25}, {reg::kClockTrim, -3}});
  const Registers r = bench.exchange({}, {reg::kAuxGpioStatus, reg::kAuxPwm + 3, reg::kClockTrim});
  EXPECT_EQ(r.at(reg::kAuxGpioStatus), 5);
  EXPECT_EQ(r.at(reg::kAuxPwm + 3), 0.25);
  EXPECT_EQ(r.at(reg::kClockTrim), -3);
}

TEST(SimMoteus, TheMillisecondCounterRunsOverInEveryFormat) {
  Bench bench;
  bench.wait_ms(128);
  const auto ms = static_cast<std::int64_t>(word(bench, reg::kMillisecondCounter));
  bench.wait_ms(40'000 - ms);
  EXPECT_EQ(word(bench, reg::kMillisecondCounter), 40'000);
  EXPECT_EQ(word(bench, reg::kMillisecondCounter, Format::int16), 40'000 - 65'536);
  EXPECT_EQ(word(bench, reg::kMillisecondCounter, Format::int8), 40'000 % 256);
  EXPECT_EQ(word(bench, reg::kMillisecondCounter, Format::float32), 40'000);
}

TEST(SimMoteus, TheTermsOfTheLawAddUpToItsTorque) {
  Bench bench;
  bench.stream({{reg::kMode, 10},
                {reg::kCommandPosition, 0.01},
                {reg::kCommandTorque, 0.02},
                {reg::kVelocityLimit, -1},
                {reg::kAccelerationLimit, -1}},
               12);
  const Registers r = bench.exchange({}, {0x030, 0x031, 0x032, 0x033, 0x034, reg::kErrorPosition});
  EXPECT_NEAR(r.at(0x030) + r.at(0x031) + r.at(0x032) + r.at(0x033), r.at(0x034), 1e-6);
  EXPECT_NEAR(r.at(0x030), 4 * r.at(reg::kErrorPosition), 1e-6);
  EXPECT_NEAR(r.at(0x033), 0.02, 1e-6);
}

TEST(SimMoteus, TheOutputCanBeSetExactlyOrToTheNearestTurn) {
  Bench bench;
  bench.drive().servo().plant().place(0.25 * kTurn);
  bench.wait_ms(1);
  bench.exchange({{reg::kSetOutputNearest, 3.1}});
  EXPECT_NEAR(bench.exchange({}).at(reg::kPosition), 3.25, 1e-3);
  bench.exchange({{reg::kSetOutputExact, -1.5}});
  EXPECT_NEAR(bench.exchange({}).at(reg::kPosition), -1.5, 1e-3);
  bench.wait_ms(20);
  EXPECT_NEAR(bench.exchange({}).at(reg::kPosition), -1.5, 1e-3);
  bench.exchange({{reg::kSetOutputExact, kNan}});
  EXPECT_NEAR(bench.exchange({}).at(reg::kPosition), -1.5, 1e-3);
}

TEST(SimMoteus, AHotBoardFadesAndThenFaults) {
  Bench bench;
  const Writes push = with(kTorque, reg::kCommandTorque, 1.5);
  bench.drive().servo().set_temperature_c(70);
  const Registers hot = bench.stream(push, 20);
  EXPECT_EQ(hot.at(reg::kMode), 10);
  EXPECT_EQ(hot.at(reg::kFault), moteus::fault::kLimitTemperature);
  EXPECT_LT(hot.at(reg::kTorque), 0.5);
  bench.drive().servo().set_temperature_c(80);
  EXPECT_EQ(bench.stream(push, 2).at(reg::kFault), moteus::fault::kOverTemperature);
  bench.drive().servo().set_temperature_c(25);
  EXPECT_EQ(bench.stream(push, 2).at(reg::kMode), 1);  // latched
  EXPECT_EQ(bench.stream(kStop, 1).at(reg::kFault), 0);
}

TEST(SimMoteus, WithoutItsEncoderItKnowsNoPositionAndFaults) {
  Bench bench;
  bench.stream(kTorque, 10);
  bench.drive().servo().set_encoder_lost(true);
  const Registers r = bench.stream(kTorque, 2);
  EXPECT_EQ(r.at(reg::kFault), moteus::fault::kEncoder);
  EXPECT_TRUE(std::isnan(r.at(reg::kPosition)));
  EXPECT_EQ(bench.exchange({}, {reg::kHomeState}).at(reg::kHomeState), 0);
}

TEST(SimMoteus, ARestartForgetsAllButWhatWasStored) {
  Bench bench;
  bench.stream(kTorque, 20);
  bench.drive().restart(1'000 * kMs + 50 * kMs);
  EXPECT_TRUE(bench.exchange({}).empty());  // deaf
  bench.wait_ms(100);
  EXPECT_EQ(bench.exchange({}).at(reg::kMode), 0);
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
