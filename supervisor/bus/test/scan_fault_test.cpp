// SPDX-License-Identifier: Apache-2.0
// Scans of buses that are slow, full, deaf, gone or never quiet: what the bus did wrong is not told of its devices.
#include <gtest/gtest.h>

#include <algorithm>
#include <string>
#include <utility>

#include "spine/hal/canopen/canopen_sdo.hpp"
#include "supervisor/bus/test/scan_rig.hpp"

namespace lithe::bus {
namespace {

using hal::Frame;
using robot::DeviceKind;
using test::found;
using test::robot_with;
using test::ScanRigOn;

// As an interface at 10 kbit/s: a frame takes 13 ms, and while one of an earlier exchange waits, all are refused.
class Slow final : public test::Watched {
 public:
  std::uint32_t bitrate() const { return 10'000; }
  void begin(std::int64_t now_ns) LITHE_RT override {
    now_ns_ = now_ns;
    stuck_ = free_at_ns_ > now_ns;
    Watched::begin(now_ns);
  }
  bool send(const Frame& frame) LITHE_RT override {
    if (stuck_) {
      too_early += hal::canopen::sdo_address(frame) == hal::canopen::Address{0x1000, 0} ? 1 : 0;
      return false;
    }
    free_at_ns_ = std::max(free_at_ns_, now_ns_) + kFrameNs;
    return Watched::send(frame);
  }
  int too_early = 0;

 private:
  static constexpr std::int64_t kFrameNs = 13'000'000;
  std::int64_t now_ns_ = 0, free_at_ns_ = 0;
  bool stuck_ = false;
};

TEST(ScanFaults, OnASlowBusEveryNodeIsAskedAndTheBusHasItsTime) {
  ScanRigOn<Slow> rig;
  for (const std::uint32_t id : {1U, 64U, 127U}) rig.add_drive(id);
  const Line line = rig.scan(robot::Protocol::canopen);
  EXPECT_EQ(found(line).size(), 3U);
  EXPECT_EQ(line.error, "");
  EXPECT_EQ(rig.bus().too_early, 0);
  for (const hal::FoundDevice& node : found(line)) EXPECT_EQ(node.twice + node.unfit, "") << node.id;
}

// A short queue: it takes three frames between two looks.
class Short final : public test::Watched {
 public:
  void begin(std::int64_t now_ns) LITHE_RT override {
    room_ = 3;
    Watched::begin(now_ns);
  }
  bool send(const Frame& frame) LITHE_RT override { return room_-- > 0 && Watched::send(frame); }

 private:
  int room_ = 0;
};

TEST(ScanFaults, AQuestionThatIsRefusedIsPutAgain) {
  ScanRigOn<Short> rig;
  for (std::uint32_t id = 1; id <= 9; ++id) rig.add_drive(id);
  rig.add_drive(127);
  const Line line = rig.scan(robot::Protocol::canopen);
  EXPECT_EQ(found(line).size(), 10U);
  for (const hal::FoundDevice& node : found(line)) EXPECT_EQ(node.twice + node.unfit, "") << node.id;
  EXPECT_EQ(line.error, "");
}

// Takes so many frames, and no more for ever.
class Stuck final : public test::Watched {
 public:
  bool send(const Frame& frame) LITHE_RT override { return taken_++ < 20 && Watched::send(frame); }

 private:
  int taken_ = 0;
};

TEST(ScanFaults, WhoCouldNotBeAskedIsNeitherMissingNorUnfit) {
  ScanRigOn<Stuck> rig;
  rig.add_drive(5);
  rig.add_drive(100);
  const Line line = rig.scan(robot::Protocol::canopen);
  EXPECT_NE(line.error.find("nodes 21 to 127"), std::string::npos) << line.error;
  const BusFindings findings =
      judge(robot_with({{DeviceKind::cia402, 5}, {DeviceKind::cia402, 100}, {DeviceKind::cia402, 101}}), 0, true, line);
  ASSERT_EQ(findings.devices.size(), 2U) << "of node 100 the heartbeat is heard, of 101 nothing";
  for (const Judged& each : findings.devices) EXPECT_EQ(each.standing, Standing::expected) << each.id;
  EXPECT_EQ(findings.error, line.error);
  EXPECT_FALSE(matches(findings));
}

// An adapter that is pulled out while the scan listens.
class Gone final : public test::Watched {
 public:
  bool send(const Frame&) LITHE_RT override { return false; }
  bool receive(Frame&) LITHE_RT override { return false; }
  std::string why_down() const override { return "/dev/ttyACM0: the adapter went away"; }
};

TEST(ScanFaults, AnAdapterThatWentAwayIsNoFaultOfTheDevices) {
  for (const auto& [kind, protocol] : {std::pair{DeviceKind::moteus, robot::Protocol::moteus},
                                       std::pair{DeviceKind::cia402, robot::Protocol::canopen}}) {
    ScanRigOn<Gone> rig;
    const Line line = rig.scan(protocol);
    const BusFindings findings = judge(robot_with({{kind, 1}}), 0, true, line);
    EXPECT_EQ(findings.error, "/dev/ttyACM0: the adapter went away");
    EXPECT_TRUE(findings.devices.empty()) << findings.devices[0].advice;
  }
}

// Loses the first frame that comes.
class Lossy final : public test::Watched {
 public:
  bool receive(Frame& frame) LITHE_RT override {
    if (!Watched::receive(frame)) return false;
    return lost_++ > 0 || Watched::receive(frame);
  }

 private:
  int lost_ = 0;
};

TEST(ScanFaults, OneLostAnswerMakesNoDriveAMissingOne) {
  ScanRigOn<Lossy> rig;
  rig.add_moteus(1, 1);
  rig.add_moteus(2, 2);
  rig.add_moteus(2, 3);
  const Line line = rig.scan(robot::Protocol::moteus);
  ASSERT_EQ(found(line).size(), 3U) << "each once, though each was asked twice";
  EXPECT_EQ(found(line)[0].id, 1U);
}

// Something comes with every look, and time goes on by itself.
class Babbler final : public test::Watched {
 public:
  bool receive(Frame& frame) LITHE_RT override {
    ++looks;
    if (looks % 2 == 0 && Watched::receive(frame)) return true;
    frame = hal::canopen::heartbeat_frame(77, hal::canopen::NmtState::operational);
    return true;
  }
  std::int64_t looks = 0;
};

TEST(ScanFaults, ABusThatIsNeverQuietEndsNoScanLate) {
  for (const robot::Protocol protocol : {robot::Protocol::moteus, robot::Protocol::canopen}) {
    ScanRigOn<Babbler> rig;
    rig.add_moteus(1, 1);
    const Time time{[&] { return rig.bus().looks * 10'000; }, [] { FAIL() << "it is never quiet"; }};
    std::vector<Line> lines;
    lines.emplace_back(&rig.bus(), protocol);
    listen(lines, 20'000'000, time);
    ask(lines.front(), time);
    EXPECT_LT(time.now_ns(), 1'500'000'000) << "0.02 s to listen, 0.3 s to find, 0.2 s for an answer; or 16 batches";
    const std::uint32_t first = protocol == robot::Protocol::moteus ? 1 : 77;
    EXPECT_EQ(found(lines.front()).at(0).id, first);
  }
}

}  // namespace
}  // namespace lithe::bus
