// SPDX-License-Identifier: Apache-2.0
// Frames of simulated devices and of nobody, in words.
#include "supervisor/bus/monitor/monitor.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <string>
#include <vector>

#include "spine/core/text.hpp"
#include "spine/core/time.hpp"
#include "spine/hal/canopen/canopen.hpp"
#include "spine/hal/canopen/canopen_sdo.hpp"
#include "spine/hal/cia402/cia402_setup.hpp"
#include "spine/hal/gateway/gateway.hpp"
#include "spine/hal/moteus/moteus.hpp"
#include "spine/hal/moteus/moteus_terminal.hpp"
#include "supervisor/bus/plan/frame_time.hpp"

namespace lithe::bus {
namespace {

using hal::Frame;
namespace canopen = hal::canopen;
namespace cia402 = hal::cia402;

Choice frankenstein() {
  const auto choice = choose({.what = LITHE_ROBOTS "/frankenstein.toml"});
  EXPECT_TRUE(choice) << choice.message();
  return *choice;
}

Frame moteus_frame(std::uint32_t id, const std::function<void(hal::moteus::SubframeWriter&)>& fill) {
  Frame frame;
  frame.id = id;
  frame.extended = id > hal::kLargestStandardId;
  frame.fd = frame.brs = true;
  hal::moteus::SubframeWriter writer(frame);
  fill(writer);
  writer.pad();
  return frame;
}

hal::FrameText moteus_text(const Frame& frame) {
  return decode(frame, robot::Protocol::moteus, frankenstein().robot, 0);
}

TEST(Decode, MoteusRegistersHaveNamesAndUnits) {
  const Frame command = moteus_frame(0x8303, [](auto& writer) {
    const double mode[] = {10}, values[] = {0.25, -1.5};
    writer.write(hal::moteus::Format::int8, hal::moteus::reg::kMode, mode);
    writer.write(hal::moteus::Format::float32, hal::moteus::reg::kCommandPosition, values);
    writer.read(hal::moteus::Format::float32, hal::moteus::reg::kPosition, 3);
  });
  const hal::FrameText asked = moteus_text(command);
  EXPECT_TRUE(asked.outbound);
  EXPECT_EQ(asked.device, 3U);
  EXPECT_EQ(asked.text, "write mode position; write position 0.25 rev, velocity -1.5 rev/s; read position to torque");
  const Frame answer = moteus_frame(0x303, [](auto& writer) {
    const double mode[] = {1}, volts[] = {24.5}, fault[] = {38};
    writer.reply(hal::moteus::Format::int8, hal::moteus::reg::kMode, mode, true);
    writer.reply(hal::moteus::Format::float32, hal::moteus::reg::kVoltage, volts, false);
    writer.reply(hal::moteus::Format::int8, hal::moteus::reg::kFault, fault, false);
  });
  const hal::FrameText said = moteus_text(answer);
  EXPECT_FALSE(said.outbound);
  EXPECT_EQ(said.device, 3U);
  EXPECT_EQ(said.text, "mode fault; voltage 24.5 V; fault over-temperature");
  Frame all;
  hal::moteus::make_discovery(all);
  EXPECT_FALSE(moteus_text(all).device) << "it is for everybody";
}

TEST(Decode, MoteusNumbersAreWholeAndPatternsAreNoNumbers) {
  const Frame answer = moteus_frame(0x300, [](auto& writer) {
    const double milliseconds[] = {1'234'567'890}, uuid[] = {std::nan(""), -1, 5, 0x12345678};
    writer.reply(hal::moteus::Format::int32, hal::moteus::reg::kMillisecondCounter, milliseconds, false);
    writer.reply(hal::moteus::Format::int32, hal::moteus::reg::kUuid, uuid, true);
  });
  EXPECT_EQ(moteus_text(answer).text,
            "milliseconds 1234567890; uuid 0 80000000, uuid 1 ffffffff, uuid 2 00000005, uuid 3 12345678");
}

TEST(Decode, AStreamWithFlowControlIsToldByWhoAsksForAReply) {
  Frame said = moteus_frame(0x300, [](auto&) {});
  said.size = 3;
  said.data = {0x43, 1, 0};
  EXPECT_FALSE(moteus_text(said).outbound);
  EXPECT_EQ(moteus_text(said).device, 3U);
  said.id = 0x8003;
  said.data = {0x44, 1, 48};
  EXPECT_TRUE(moteus_text(said).outbound);
  EXPECT_EQ(moteus_text(said).device, 3U);
}

std::string canopen_text(const Frame& frame) {
  return decode(frame, robot::Protocol::canopen, frankenstein().robot, 2).text;
}

TEST(Decode, CanopenObjectsStatesAndReasonsHaveNames) {
  EXPECT_EQ(canopen_text(canopen::sync_frame()), "SYNC");
  EXPECT_EQ(canopen_text(canopen::nmt_frame(canopen::NmtCommand::start, 2)), "NMT start: node 2");
  EXPECT_EQ(canopen_text(canopen::nmt_frame(canopen::NmtCommand::reset_node, 0)), "NMT reset node: all nodes");
  EXPECT_EQ(canopen_text(canopen::heartbeat_frame(2, canopen::NmtState::stopped)), "heartbeat: stopped");
  EXPECT_EQ(canopen_text(canopen::emergency_frame(1, {canopen::emergency::kTooHot, 8})),
            "emergency 4210h too hot, error register 08h");
  EXPECT_EQ(canopen_text(canopen::sdo_read_request(1, {0x6041, 0})), "SDO read 6041h:0 status");
  EXPECT_EQ(canopen_text(canopen::sdo_write_request(1, {0x6060, 0}, 10, 1)), "SDO write 6060h:0 mode = 10");
  Frame download = canopen::sdo_write_request(1, {0x1008, 0}, 12, 4);
  download.data[0] = 0x21;
  EXPECT_EQ(canopen_text(download), "SDO write 1008h:0 device name: 12 bytes, in segments");
  EXPECT_EQ(canopen_text(canopen::sdo_read_answer(1, {0x1018, 4}, 7, 4)), "SDO 1018h:4 identity = 7");
  EXPECT_EQ(canopen_text(canopen::sdo_abort(0x581, {0x1234, 0}, canopen::abort_code::kNoObject)),
            "SDO abort 1234h:0: no such object (06020000h)");
}

TEST(Decode, ProcessDataOfADriveOfTheFileIsTakenApart) {
  const cia402::Mode torque = cia402::Mode::torque;
  const std::uint32_t command[] = {cia402::control::kEnable, static_cast<std::uint32_t>(-250)};
  const Frame out = cia402::pdo::command_map(torque).pack(cia402::pdo::command_id(1), command);
  EXPECT_EQ(canopen_text(out).substr(0, 12), "RPDO1 enable");
  EXPECT_NE(canopen_text(out).find("target torque -250/1000"), std::string::npos) << canopen_text(out);
  const std::uint32_t answer[] = {cia402::encode_state(cia402::State::operation_enabled), 77, 12};
  const Frame in = cia402::pdo::answer_map().pack(cia402::pdo::transmit_id(cia402::pdo::kAnswer, 1), answer);
  EXPECT_NE(canopen_text(in).find("TPDO2 operation enabled"), std::string::npos) << canopen_text(in);
  EXPECT_EQ(canopen_text(canopen::blank(0x1a5, 2)), "TPDO1 00 00") << "of no drive of the file";
  EXPECT_NE(canopen_text(canopen::blank(cia402::pdo::command_id(1), 1)).find("shorter"), std::string::npos);
}

TEST(Decode, WhatNobodySaysIsStillALine) {
  std::mt19937_64 random(3);
  const Choice choice = frankenstein();
  for (int round = 0; round < 60'000; ++round) {
    Frame frame;
    const bool likely = round % 2 == 0;
    frame.id = static_cast<std::uint32_t>(random() & (likely ? 0x7ff : hal::kLargestId));
    if (round % 5 == 0) frame.id = static_cast<std::uint32_t>(hal::gateway::kIdBase | (random() & 0x7f03));
    frame.extended = frame.id > hal::kLargestStandardId;
    frame.fd = random() % 2 == 0;
    frame.size = static_cast<std::uint8_t>(random() % (frame.fd ? 256 : 9));
    for (std::uint8_t& byte : frame.data) byte = static_cast<std::uint8_t>(random());
    for (const robot::Protocol protocol : {robot::Protocol::moteus, robot::Protocol::canopen}) {
      const hal::FrameText decoded = decode(frame, protocol, choice.robot, 2);
      ASSERT_FALSE(decoded.text.empty());
      ASSERT_TRUE(is_printable(decoded.text)) << printable(decoded.text);
    }
  }
}

class Nothing final : public FrameSource {
 public:
  bool next(CapturedFrame&) override { return false; }
  std::uint64_t lost() const override { return 5; }
  std::uint64_t errors(std::size_t bus) const override { return bus; }
};

TEST(Monitor, NamesDevicesFiltersThemAndCountsAll) {
  const Choice choice = frankenstein();
  Monitor monitor(choice, {.devices = {"boom_drive"}}, 1'000'000'000);
  EXPECT_EQ(monitor.complaint(), "");
  EXPECT_FALSE(monitor.see({1'000'000'000, 2, std::nullopt, canopen::sync_frame()}));
  EXPECT_FALSE(monitor.see({1'000'000'000, 2, std::nullopt, canopen::heartbeat_frame(1, canopen::NmtState::stopped)}));
  const auto line =
      monitor.see({1'500'000'000, 2, std::nullopt, canopen::heartbeat_frame(2, canopen::NmtState::stopped)});
  ASSERT_TRUE(line);
  EXPECT_NE(line->find("0.500000 can2     < 702      boom_drive         heartbeat: stopped"), std::string::npos)
      << *line;
  const Json all = monitor.statistics(Nothing(), 2'000'000'000).at("statistics");
  EXPECT_EQ(all.at("not_seen"), 5);
  EXPECT_EQ(all.at("buses").at(2).at("in"), 2);
  EXPECT_EQ(all.at("buses").at(2).at("out"), 1) << "SYNC is ours";
  EXPECT_EQ(all.at("buses").at(2).at("errors"), 2);
  EXPECT_NE(Monitor(choice, {.devices = {"knee"}}, 0).complaint().find("there are shoulder_drive"), std::string::npos);
  EXPECT_EQ(Monitor(choice, {.devices = {"7"}}, 0).complaint(), "");
}

TEST(Monitor, LoadIsTheExactTimeOfTheFramesAtTheRatesOfTheFile) {
  const Choice choice = frankenstein();
  Monitor monitor(choice, {}, 0);
  const Frame frame = canopen::heartbeat_frame(2, canopen::NmtState::operational);
  for (int i = 0; i < 100; ++i) monitor.see({0, 2, true, frame});
  const double expected_s =
      100e-9 * static_cast<double>(hal::duration_ns(hal::exact_bits(frame), {1'000'000, 1'000'000}));
  const Json all = monitor.statistics(Nothing(), 1'000'000'000).at("statistics");
  EXPECT_DOUBLE_EQ(all.at("buses").at(2).at("load"), expected_s);
  EXPECT_EQ(all.at("buses").at(2).at("frames_per_s"), 100.0);
  EXPECT_EQ(all.at("buses").at(2).at("out"), 100);
}

class Broken final : public FrameSource {
 public:
  bool next(CapturedFrame&) override { return false; }
  std::string why_down() override { return ++looks_ == 1 ? "can0: gone" : ""; }

 private:
  int looks_ = 0;
};

TEST(Monitor, AnErrorOfTheSourceIsReportedWhenItComesAndWhenItGoes) {
  const Choice choice = frankenstein();
  const MonitorOptions options{.seconds = 60};
  Monitor monitor(choice, options, monotonic_ns());
  Broken source;
  std::vector<std::string> told;
  watch(
      source, monitor, options, [&] { return told.size() == 2; }, [](const std::string&) {},
      [&](const std::string& words) { told.push_back(words); });
  EXPECT_EQ(told, (std::vector<std::string>{"can0: gone", "all is heard again"}));
}

TEST(Monitor, EndsAfterSoManyFramesOrSoLong) {
  const Choice choice = frankenstein();
  Monitor counted(choice, {.count = 2}, 0);
  const CapturedFrame one{0, 2, true, canopen::sync_frame()};
  EXPECT_TRUE(counted.see(one));
  EXPECT_FALSE(counted.finished(1'000'000'000));
  EXPECT_TRUE(counted.see(one));
  EXPECT_TRUE(counted.finished(0));
  const Monitor timed(choice, {.seconds = 0.5}, 0);
  EXPECT_FALSE(timed.finished(499'000'000));
  EXPECT_TRUE(timed.finished(500'000'000));
}

}  // namespace
}  // namespace lithe::bus
