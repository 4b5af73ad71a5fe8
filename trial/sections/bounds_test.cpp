// SPDX-License-Identifier: Apache-2.0
// Laws that use more entries than the robot has joints. They run in this process: one that strays stays in its arrays.
#include <gtest/gtest.h>

#include <limits>
#include <string>

#include "spine/robot/robot.hpp"
#include "trial/sections/sections.hpp"

namespace lithe::trial {
namespace {

constexpr std::uint32_t kJoints = 2;  // of the robot that the laws are tried for

struct BareLaw {
  struct Params {};
  struct State {};
};
struct WritesTorque : BareLaw {
  static void step(const Tick& t, const Params&, State&, Effort& u) {
    for (std::size_t j = 0; j < 6; ++j) u.torque_nm[j] = 0.1 + 0 * t.position_rad[0];
  }
};
struct WritesPosition : BareLaw {
  static void step(const Tick&, const Params&, State&, Effort& u) { u.position_rad[31] = 0.5; }
};
struct ComputesAll : BareLaw {  // nothing to see while the inputs there are zero
  static void step(const Tick& t, const Params&, State&, Effort& u) {
    for (std::size_t j = 0; j < kMaxJoints; ++j) u.torque_nm[j] = -0.1 * t.velocity_rad_s[j];
  }
};
struct ReadsNeighbour : BareLaw {  // the last joint has none
  static void step(const Tick& t, const Params&, State&, Effort& u) {
    for (std::size_t j = 0; j < t.joints; ++j) u.torque_nm[j] = t.setpoint_position_rad[j + 1] - t.position_rad[j];
  }
};
struct ReadsLate : BareLaw {
  struct Probes {
    double sum = 0;
  };
  static void step(const Tick& t, const Params&, State&, Effort&, Probes& p) { p.sum = t.torque_nm[17]; }
};
struct CopiesWholeArrays {  // harmless: what is beyond the joints stays zero, or is never used
  struct Params {};
  struct State {
    JointArray last_rad{};
  };
  static void step(const Tick& t, const Params&, State& s, Effort& u) {
    s.last_rad = t.position_rad;
    u.velocity_rad_s.fill(0);
    u.position_rad.fill(0);
    for (std::uint32_t j = 0; j < t.joints; ++j) u.torque_nm[j] = 0.1 * s.last_rad[j];
  }
};
constexpr LitheLaw kWritesTorque = describe<WritesTorque>("writes_torque");
constexpr LitheLaw kWritesPosition = describe<WritesPosition>("writes_position");
constexpr LitheLaw kComputesAll = describe<ComputesAll>("computes_all");
constexpr LitheLaw kReadsNeighbour = describe<ReadsNeighbour>("reads_neighbour");
constexpr LitheLaw kReadsLate = describe<ReadsLate>("reads_late");
constexpr LitheLaw kCopiesWholeArrays = describe<CopiesWholeArrays>("copies_whole_arrays");

// Why the trial refuses it on harmless inputs; empty: it does not.
std::string refused(const LitheLaw& law, std::uint32_t joints = kJoints) {
  TrialSetup setup;
  setup.robot.joints.resize(joints);
  setup.robot.rate_hz = 1000;
  setup.clock = RawClock::calibrate();
  const Recording none;
  LawHarness one(law, {}, {}, setup.clock), other(law, {}, {}, setup.clock);
  Report report;
  TrialContext context{setup, law, none, one, other, 300'000, std::numeric_limits<std::int64_t>::max(), report, {}};
  const bool passed = run_benign(context);
  EXPECT_EQ(passed, report.refused[0] == '\0');
  return text_of(report.refused);
}

TEST(Bounds, AWriteBeyondTheJointsIsNamed) {
  EXPECT_NE(refused(kWritesTorque).find("it writes torque_nm[2], but this robot has 2 joints, 0 to 1"),
            std::string::npos)
      << refused(kWritesTorque);
  EXPECT_NE(refused(kWritesPosition).find("it writes position_rad[31]"), std::string::npos);
  EXPECT_NE(refused(kComputesAll).find("it writes torque_nm[2]"), std::string::npos) << refused(kComputesAll);
}

TEST(Bounds, AReadBeyondTheJointsIsNamed) {
  EXPECT_NE(refused(kReadsNeighbour).find("it reads setpoint_position_rad[2], but this robot has 2 joints, 0 to 1"),
            std::string::npos)
      << refused(kReadsNeighbour);
  EXPECT_NE(refused(kReadsLate).find("it reads torque_nm[17]"), std::string::npos) << refused(kReadsLate);
}

TEST(Bounds, WhatStaysWithinTheJointsPasses) {
  EXPECT_EQ(refused(kCopiesWholeArrays), "");
  EXPECT_EQ(refused(kWritesTorque, 6), "") << "a robot with as many joints as the law writes";
  EXPECT_EQ(refused(kReadsLate, 18), "");
  EXPECT_EQ(refused(kComputesAll, kMaxJoints), "");
}

}  // namespace
}  // namespace lithe::trial
