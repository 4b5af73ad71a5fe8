// SPDX-License-Identifier: Apache-2.0
// Simulated devices at the far end of a bus, found, asked and held against a robot file.
#include "supervisor/bus/scan/scan.hpp"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <memory>

#include "spine/hal/canopen/canopen_sdo.hpp"
#include "spine/hal/moteus/moteus_terminal.hpp"
#include "supervisor/bus/scan/place.hpp"
#include "supervisor/bus/test/scan_rig.hpp"

namespace lithe::bus {
namespace {

using hal::Frame;
using robot::DeviceKind;
using test::found;
using test::of;
using test::robot_with;
using test::ScanRig;

TEST(Scan, FindsDrivesAndGatewaysAndWhatTheyAre) {
  ScanRig rig;
  rig.add_moteus(1, 11);
  rig.add_moteus(9, 12);
  rig.add_gateway(20);
  const Line line = rig.scan(robot::Protocol::moteus);
  ASSERT_EQ(found(line).size(), 3U);
  const auto robot = robot_with({{DeviceKind::moteus, 1}, {DeviceKind::moteus, 9}, {DeviceKind::gateway, 20}});
  const BusFindings findings = judge(robot, 0, true, line);
  EXPECT_TRUE(matches(findings)) << findings.error;
  const auto& serial = hal::sim::MoteusIdentity::of(12).serial;
  const std::string what =
      fmt::format("firmware 1.0.0, register map 5, serial {:08x}{:08x}{:08x}, ", serial[0], serial[1], serial[2]);
  EXPECT_TRUE(of(findings, 9).what.starts_with(what)) << of(findings, 9).what;
  EXPECT_NE(of(findings, 20).what.find("analog, digital, imu"), std::string::npos) << of(findings, 20).what;
}

TEST(Scan, OfTwoWithOneIdEachIsAskedForItself) {
  ScanRig rig;
  rig.add_moteus(9, 1);
  rig.add_moteus(9, 2);
  const Line line = rig.scan(robot::Protocol::moteus);
  const auto both = found(line);
  ASSERT_EQ(both.size(), 2U);
  EXPECT_TRUE(both[0].what.starts_with("firmware ") && both[1].what.starts_with("firmware "));
  EXPECT_NE(both[0].what, both[1].what) << "each says its own serial number";
  const BusFindings findings = judge(robot_with({{DeviceKind::moteus, 9}}), 0, true, line);
  EXPECT_FALSE(matches(findings));
  EXPECT_EQ(findings.devices[0].standing, Standing::twice);
  EXPECT_EQ(findings.devices[1].standing, Standing::twice);
}

TEST(Scan, NothingIsSaidThatCouldMoveAMotor) {
  ScanRig rig;
  rig.add_moteus(1, 1);
  rig.add_moteus(1, 2);
  rig.scan(robot::Protocol::moteus);
  ASSERT_FALSE(rig.bus().sent().empty());
  for (const Frame& frame : rig.bus().sent()) {
    hal::moteus::SubframeReader reader(frame.payload());
    hal::moteus::Subframe s;
    while (reader.next(s)) {
      const bool picks_one =
          s.kind == hal::moteus::Kind::write && s.start == hal::moteus::reg::kUuidMask && s.count == 4;
      EXPECT_TRUE(s.kind == hal::moteus::Kind::read || picks_one);
    }
  }
  ScanRig drives;
  drives.add_drive(1);
  drives.scan(robot::Protocol::canopen);
  for (const Frame& frame : drives.bus().sent()) {
    EXPECT_EQ(hal::canopen::function_of(frame), hal::canopen::cob::kSdoRequest);
    const bool reads = frame.data[0] == 0x40 || frame.data[0] == 0x60 || frame.data[0] == 0x70 || frame.data[0] == 0x80;
    EXPECT_TRUE(reads) << int{frame.data[0]};
  }
}

TEST(Scan, ReadsTheIdentityOfCanopenNodes) {
  ScanRig rig;
  rig.add_drive(1);
  rig.add_drive(126);
  const Line line = rig.scan(robot::Protocol::canopen);
  const auto nodes = found(line);
  ASSERT_EQ(nodes.size(), 2U);
  EXPECT_EQ(nodes[1].profile, 402U);
  for (const char* part : {"', profile 402, vendor ", ", product ", ", revision ", ", serial 0000007eh"})
    EXPECT_NE(nodes[1].what.find(part), std::string::npos) << nodes[1].what;
  EXPECT_TRUE(matches(judge(robot_with({{DeviceKind::cia402, 1}, {DeviceKind::cia402, 126}}), 0, true, line)));
}

TEST(Scan, TwoNodesWithOneIdGiveTwoAnswers) {
  ScanRig rig;
  rig.add_drive(5);
  rig.add_drive(5);
  const Line line = rig.scan(robot::Protocol::canopen);
  EXPECT_TRUE(found(line).at(0).twice.starts_with("2 answers came to one question"));
  EXPECT_EQ(judge(robot_with({{DeviceKind::cia402, 5}}), 0, true, line).devices.at(0).standing, Standing::twice);
}

// Answers SDO requests for one object and has no other.
class Sensor final : public hal::BusNode {
 public:
  void on_frame(const Frame& frame, std::int64_t, hal::FrameQueue& answers) LITHE_RT override {
    if (frame.id != 0x60a) return;
    const auto address = hal::canopen::sdo_address(frame);
    const bool type = address == hal::canopen::Address{0x1000, 0};
    answers.push(type ? hal::canopen::sdo_read_answer(10, address, 401, 4)
                      : hal::canopen::sdo_abort(0x58a, address, hal::canopen::abort_code::kNoObject));
  }
  void on_time(std::int64_t, hal::FrameQueue& answers) LITHE_RT override {
    answers.push(hal::canopen::heartbeat_frame(10, hal::canopen::NmtState::stopped));
    answers.push(hal::canopen::heartbeat_frame(11, hal::canopen::NmtState::operational));
  }
};

TEST(Scan, AnotherProfileAndANodeThatOnlyBeatsAreUnfit) {
  ScanRig rig;
  rig.add(std::make_unique<Sensor>());
  const Line line = rig.scan(robot::Protocol::canopen);
  const auto robot = robot_with({{DeviceKind::cia402, 10}, {DeviceKind::cia402, 11}});
  const BusFindings findings = judge(robot, 0, true, line);
  EXPECT_EQ(of(findings, 10).standing, Standing::unfit);
  EXPECT_EQ(of(findings, 10).what, "profile 401, heartbeat: stopped");
  EXPECT_EQ(of(findings, 11).standing, Standing::unfit);
  EXPECT_FALSE(matches(findings));
}

TEST(Scan, TheMissingAndTheUnknownAreBroughtTogether) {
  ScanRig rig;
  rig.add_moteus(7, 1);
  const Line line = rig.scan(robot::Protocol::moteus);
  const BusFindings findings = judge(robot_with({{DeviceKind::moteus, 1}}), 0, true, line);
  EXPECT_FALSE(matches(findings));
  EXPECT_EQ(of(findings, 7).standing, Standing::unknown);
  EXPECT_EQ(of(findings, 1).standing, Standing::missing);
  EXPECT_NE(of(findings, 1).advice.find("write id = 7 in robot.toml"), std::string::npos);
  const BusFindings silence = judge(robot_with({{DeviceKind::moteus, 1}}), 0, true, Line{});
  EXPECT_NE(of(silence, 1).advice.find("power"), std::string::npos);
}

TEST(Scan, AnotherRegisterMapIsUnfit) {
  EXPECT_EQ(hal::moteus::describe({.id = 1}, hal::moteus::Identity{.register_map = 5}).unfit, "");
  const auto other = hal::moteus::describe({.id = 1}, hal::moteus::Identity{.register_map = 4});
  EXPECT_NE(other.unfit.find("register map 4"), std::string::npos);
}

TEST(Scan, WhatIsUnfitOrThereTwiceIsJudgedSo) {
  // Finds one device that cannot be used, or two with one id.
  class Unfit final : public hal::Scanner {
   public:
    explicit Unfit(bool twice) : twice_(twice) {}
    std::string on_frame(const Frame&) override { return ""; }
    std::vector<hal::FoundDevice> found(bool) const override {
      return {{.id = 1, .what = "", .twice = twice_ ? "take one off" : "", .unfit = "flash it"}};
    }

   private:
    bool twice_;
  };
  for (const bool twice : {false, true}) {
    Line line;
    line.scanners.clear();
    line.scanners.push_back({DeviceKind::moteus, std::make_unique<Unfit>(twice)});
    const BusFindings findings = judge(robot_with({{DeviceKind::moteus, 1}}), 0, true, line);
    EXPECT_EQ(of(findings, 1).standing, twice ? Standing::twice : Standing::unfit);
    EXPECT_EQ(of(findings, 1).advice, twice ? "take one off" : "flash it");
  }
}

// Somebody else's program: it says the same every millisecond.
class Commander final : public hal::BusNode {
 public:
  explicit Commander(const Frame& frame) : frame_(frame) {}
  void on_frame(const Frame&, std::int64_t, hal::FrameQueue&) LITHE_RT override {}
  void on_time(std::int64_t, hal::FrameQueue& answers) LITHE_RT override { answers.push(frame_); }

 private:
  Frame frame_;
};

TEST(Scan, NothingIsAskedWhereSomebodyElseCommands) {
  Frame query;
  hal::moteus::make_discovery(query);
  Frame answer;
  answer.id = 0x100;
  answer.fd = true;
  for (const Frame& heard : {query, answer}) {
    ScanRig rig;
    rig.add_moteus(1, 1);
    rig.add(std::make_unique<Commander>(heard));
    const Line line = rig.scan(robot::Protocol::moteus);
    EXPECT_TRUE(rig.bus().sent().empty());
    EXPECT_FALSE(judge(robot_with({}), 0, false, line).error.empty());
  }
  for (const Frame& heard :
       {hal::canopen::sync_frame(), hal::canopen::blank(0x203, 8), hal::canopen::sdo_read_request(3, {0x1000, 0})}) {
    ScanRig rig;
    rig.add_drive(1);
    rig.add(std::make_unique<Commander>(heard));
    const Line line = rig.scan(robot::Protocol::canopen);
    EXPECT_FALSE(line.commander.empty());
    EXPECT_TRUE(rig.bus().sent().empty());
    for (const Judged& each : judge(robot_with({{DeviceKind::cia402, 1}}), 0, true, line).devices)
      EXPECT_NE(each.standing, Standing::unfit) << "who was not asked cannot answer";
  }
}

TEST(Scan, TheQuestionsFollowTheFileAndElseTheKindOfBus) {
  robot::RobotConfig robot = robot_with({{DeviceKind::gateway, 3}, {DeviceKind::cia402, 1}});
  EXPECT_EQ(protocol_of(robot, 0), robot::Protocol::canopen);
  robot.devices.clear();
  EXPECT_EQ(protocol_of(robot, 0), robot::Protocol::moteus);
  robot.buses[0].data_bitrate = 0;
  EXPECT_EQ(protocol_of(robot, 0), robot::Protocol::canopen);
}

}  // namespace
}  // namespace lithe::bus
