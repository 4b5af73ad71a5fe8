// SPDX-License-Identifier: Apache-2.0
// Simulated devices at the far end of a bus, found, asked and held against a robot file.
#include "supervisor/bus/scan/scan.hpp"

#include <gtest/gtest.h>

#include <memory>

#include "spine/hal/canopen/canopen_sdo.hpp"
#include "supervisor/bus/scan/judge.hpp"
#include "supervisor/bus/test/scan_rig.hpp"

namespace lithe::bus {
namespace {

using hal::Frame;
using robot::DeviceKind;
using test::of;
using test::robot_with;
using test::ScanRig;

TEST(Scan, FindsDrivesAndGatewaysAndWhatTheyAre) {
  ScanRig rig;
  rig.add_moteus(1, 11);
  rig.add_moteus(9, 12);
  rig.add_gateway(20);
  const BusObservation observed = rig.scan(Protocol::moteus);
  ASSERT_EQ(observed.moteus.size(), 2U);
  ASSERT_TRUE(observed.moteus[1].identity);
  EXPECT_EQ(observed.moteus[1].identity->firmware, 0x010000U);
  EXPECT_EQ(observed.moteus[1].identity->register_map, hal::moteus::kKnownRegisterMap);
  EXPECT_EQ(observed.moteus[1].identity->serial, hal::sim::MoteusIdentity::of(12).serial);
  EXPECT_TRUE(observed.gateways.contains(20));
  const auto robot = robot_with({{DeviceKind::moteus, 1}, {DeviceKind::moteus, 9}, {DeviceKind::gateway, 20}});
  const BusFindings findings = judge(robot, 0, true, observed);
  EXPECT_TRUE(matches(findings)) << findings.trouble;
  EXPECT_NE(of(findings, 9).what.find("firmware 1.0.0, register map 5, serial "), std::string::npos);
  EXPECT_NE(of(findings, 20).what.find("analog, digital, imu"), std::string::npos) << of(findings, 20).what;
}

TEST(Scan, OfTwoWithOneIdEachIsAskedForItself) {
  ScanRig rig;
  rig.add_moteus(9, 1);
  rig.add_moteus(9, 2);
  const BusObservation observed = rig.scan(Protocol::moteus);
  ASSERT_EQ(observed.moteus.size(), 2U);
  ASSERT_TRUE(observed.moteus[0].identity && observed.moteus[1].identity);
  EXPECT_NE(observed.moteus[0].identity->serial, observed.moteus[1].identity->serial);
  const BusFindings findings = judge(robot_with({{DeviceKind::moteus, 9}}), 0, true, observed);
  EXPECT_FALSE(matches(findings));
  EXPECT_EQ(findings.devices[0].standing, Standing::twice);
  EXPECT_EQ(findings.devices[1].standing, Standing::twice);
}

TEST(Scan, NothingIsSaidThatCouldMoveAMotor) {
  ScanRig rig;
  rig.add_moteus(1, 1);
  rig.add_moteus(1, 2);
  rig.scan(Protocol::moteus);
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
  drives.scan(Protocol::canopen);
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
  const BusObservation observed = rig.scan(Protocol::canopen);
  ASSERT_EQ(observed.nodes.size(), 2U);
  const ObservedNode& node = observed.nodes.at(126);
  EXPECT_EQ(*node.device_type & 0xffff, 402U);
  EXPECT_TRUE(node.vendor && node.product && node.revision);
  EXPECT_EQ(node.serial, 126U);
  EXPECT_FALSE(node.name.empty());
  EXPECT_TRUE(matches(judge(robot_with({{DeviceKind::cia402, 1}, {DeviceKind::cia402, 126}}), 0, true, observed)));
}

TEST(Scan, TwoNodesWithOneIdGiveTwoAnswers) {
  ScanRig rig;
  rig.add_drive(5);
  rig.add_drive(5);
  const BusObservation observed = rig.scan(Protocol::canopen);
  EXPECT_EQ(observed.nodes.at(5).answers, 2U);
  EXPECT_EQ(judge(robot_with({{DeviceKind::cia402, 5}}), 0, true, observed).devices.at(0).standing, Standing::twice);
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
  const BusObservation observed = rig.scan(Protocol::canopen);
  const auto robot = robot_with({{DeviceKind::cia402, 10}, {DeviceKind::cia402, 11}});
  const BusFindings findings = judge(robot, 0, true, observed);
  EXPECT_EQ(of(findings, 10).standing, Standing::unfit);
  EXPECT_EQ(of(findings, 10).what, "profile 401, heartbeat: stopped");
  EXPECT_EQ(of(findings, 11).standing, Standing::unfit);
  EXPECT_FALSE(matches(findings));
}

TEST(Scan, TheMissingAndTheUnknownAreBroughtTogether) {
  ScanRig rig;
  rig.add_moteus(7, 1);
  const BusObservation observed = rig.scan(Protocol::moteus);
  const BusFindings findings = judge(robot_with({{DeviceKind::moteus, 1}}), 0, true, observed);
  EXPECT_FALSE(matches(findings));
  EXPECT_EQ(of(findings, 7).standing, Standing::unknown);
  EXPECT_EQ(of(findings, 1).standing, Standing::missing);
  EXPECT_NE(of(findings, 1).advice.find("write id = 7 in robot.toml"), std::string::npos);
  const BusFindings silence = judge(robot_with({{DeviceKind::moteus, 1}}), 0, true, BusObservation{});
  EXPECT_NE(of(silence, 1).advice.find("power"), std::string::npos);
}

TEST(Scan, AnotherRegisterMapIsUnfit) {
  ScanRig rig;
  rig.add_moteus(1, 1);
  BusObservation observed = rig.scan(Protocol::moteus);
  observed.moteus[0].identity->register_map = 4;
  const BusFindings findings = judge(robot_with({{DeviceKind::moteus, 1}}), 0, true, observed);
  EXPECT_EQ(of(findings, 1).standing, Standing::unfit);
  EXPECT_NE(of(findings, 1).advice.find("register map 4"), std::string::npos);
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
    const BusObservation observed = rig.scan(Protocol::moteus);
    EXPECT_TRUE(rig.bus().sent().empty());
    EXPECT_FALSE(judge(robot_with({}), 0, false, observed).trouble.empty());
  }
  for (const Frame& heard :
       {hal::canopen::sync_frame(), hal::canopen::blank(0x203, 8), hal::canopen::sdo_read_request(3, {0x1000, 0})}) {
    ScanRig rig;
    rig.add_drive(1);
    rig.add(std::make_unique<Commander>(heard));
    const BusObservation observed = rig.scan(Protocol::canopen);
    EXPECT_FALSE(observed.commander.empty());
    EXPECT_TRUE(rig.bus().sent().empty());
    for (const Judged& each : judge(robot_with({{DeviceKind::cia402, 1}}), 0, true, observed).devices) {
      EXPECT_NE(each.standing, Standing::unfit) << "who was not asked cannot answer";
    }
  }
}

TEST(Scan, TheQuestionsFollowTheFileAndElseTheKindOfBus) {
  robot::RobotConfig robot = robot_with({{DeviceKind::gateway, 3}, {DeviceKind::cia402, 1}});
  EXPECT_EQ(protocol_of(robot, 0), Protocol::canopen);
  robot.devices.clear();
  EXPECT_EQ(protocol_of(robot, 0), Protocol::moteus);
  robot.buses[0].data_bitrate = 0;
  EXPECT_EQ(protocol_of(robot, 0), Protocol::canopen);
}

}  // namespace
}  // namespace lithe::bus
