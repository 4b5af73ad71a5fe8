// SPDX-License-Identifier: Apache-2.0
// The simulated robot that a law is tried with. Here laws run in this process, so that they can tell what they saw.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <limits>
#include <string>

#include "spine/robot/robot.hpp"
#include "spine/wire/wire.hpp"
#include "trial/sections/sections.hpp"

namespace lithe::trial {
namespace {

robot::RobotConfig robot_of(const std::string& file) {
  auto robot = robot::load_robot(LITHE_ROBOTS "/" + file);
  EXPECT_TRUE(robot) << robot.message();
  return *robot;
}

// An arm that starts raised, with limits that it falls out of when nothing holds it.
robot::RobotConfig raised_arm() {
  robot::RobotConfig robot = robot_of("arm.toml");
  robot.joints[0].sim.initial_position_rad = 1.5;
  robot.joints[0].position_min_rad = 0.9;
  robot.joints[0].position_max_rad = 2.4;
  return robot;
}

struct Rig {
  explicit Rig(robot::RobotConfig robot) {
    setup.robot = std::move(robot);
    setup.clock = RawClock::calibrate();
    const auto ready = prepare_runs(setup);
    EXPECT_TRUE(ready) << ready.message();
    // A second, also where that takes minutes.
    setup.plain.run_ticks = setup.heavy.run_ticks = static_cast<std::uint32_t>(std::lround(setup.robot.rate_hz));
  }

  // Whether this law passes, when all of its steps together may take so long.
  bool run(const LitheLaw& law, std::int64_t law_ns = std::numeric_limits<std::int64_t>::max()) {
    const Recording none;
    LawHarness one(law, {}, {}, setup.clock), other(law, {}, {}, setup.clock);
    report = {};
    TrialContext context{setup, law, none, one, other, 300'000, 0, report, {}, law_ns};
    return run_loop(context);
  }

  TrialSetup setup;
  Report report;
};

struct NoParamsNoState {
  struct Params {};
  struct State {};
};
struct Limp : NoParamsNoState {
  static void step(const Tick&, const Params&, State&, Effort&) {}
};
struct Holds : NoParamsNoState {
  static void step(const Tick& t, const Params&, State&, Effort& u) {
    for (std::uint32_t j = 0; j < t.joints; ++j)
      u.torque_nm[j] = 1.5 * (t.setpoint_position_rad[j] - t.position_rad[j]) - 0.08 * t.velocity_rad_s[j];
  }
};
struct PushesAway : NoParamsNoState {
  static void step(const Tick& t, const Params&, State&, Effort& u) {
    for (std::uint32_t j = 0; j < t.joints; ++j) u.torque_nm[j] = t.position_rad[j] < 1.6 ? -0.6 : 0.6;
  }
};
struct AsksTooMuch : NoParamsNoState {
  static void step(const Tick& t, const Params&, State&, Effort& u) { std::fill_n(u.torque_nm.begin(), t.joints, 2.0); }
};
constexpr std::int64_t kNoTime = -1;
constexpr LitheLaw kAsksTooMuch = describe<AsksTooMuch>("asks_too_much");
constexpr LitheLaw kLimp = describe<Limp>("limp");
constexpr LitheLaw kHolds = describe<Holds>("holds");
constexpr LitheLaw kPushesAway = describe<PushesAway>("pushes_away");

// Torque that is asked for from the first tick on acts from the first tick on.
void expect_drives_on(const robot::RobotConfig& robot, int exchanges = 4) {
  Rig rig(robot);
  hal::ActuatorCommand command;
  hal::ActuatorState state;
  command.joints = rig.setup.joints();
  command.act(hal::DriveAction::torque);
  command.position_rad.fill(std::numeric_limits<double>::quiet_NaN());
  command.torque_nm.fill(0.1);
  command.max_torque_nm.fill(1);
  std::int64_t now_ns = rig.setup.plain.from_ns;
  for (int k = 0; k < exchanges; ++k, now_ns += rig.setup.period_ns()) {
    ++command.tick;
    rig.setup.plain.actuators->cycle(command, state, now_ns);
    for (std::uint32_t j = 0; j < command.joints; ++j)
      EXPECT_EQ(state.status[j] & wire::joint_status::kNotReady, 0u) << robot.name << " joint " << j << " tick " << k;
  }
  for (std::uint32_t j = 0; j < command.joints; ++j) EXPECT_GT(state.torque_nm[j], 0.003) << robot.name << " " << j;
}

// The law is tried all the same, from the limit on inwards.
TEST(SimulatedRun, ARobotThatStandsOutsideItsLimitsIsRiddenFromInside) {
  robot::RobotConfig outside = robot_of("arm.toml");
  outside.joints[0].sim.initial_position_rad = outside.joints[0].position_max_rad + 0.5;
  Rig rig(outside);
  EXPECT_TRUE(rig.run(kHolds)) << rig.report.refused.data();
  EXPECT_EQ(rig.report.loop.fault, 0u);
  EXPECT_GE(rig.report.loop.ticks, 1000u) << "it used to end in its first";
}

TEST(SimulatedRun, BeginsWhenEveryDriveIsSetUpAndOn) {
  for (const char* file : {"arm.toml", "frankenstein.toml", "quadruped.toml"}) expect_drives_on(robot_of(file));
  robot::RobotConfig fast = robot_of("arm.toml");
  fast.rate_hz = 10'000;
  expect_drives_on(fast);
  robot::RobotConfig divided = robot_of("frankenstein.toml");
  for (robot::DeviceConfig& device : divided.devices) device.rate_divider = 4;
  expect_drives_on(divided, 4 * 4);
}

TEST(SimulatedRun, ALawThatIsStoppedSoonerThanTheRobotAloneIsRefused) {
  robot::RobotConfig undeclared = raised_arm();
  undeclared.joints[0].inertia_max_kg_m2 = 0;  // so the guard cannot know how to stop it
  Rig rig(undeclared);
  ASSERT_NE(rig.setup.plain.baseline.fault, 0u) << "it falls out of its limits";
  EXPECT_FALSE(rig.run(kPushesAway));
  EXPECT_LT(rig.report.loop.fault_tick, rig.setup.plain.baseline.fault_tick);
  EXPECT_NE(text_of(rig.report.refused).find("without a law it took"), std::string::npos);
}

// Which takes more than a step of the torque's slew.
TEST(SimulatedRun, ALawThatHoldsWhatWouldFallPasses) {
  Rig rig(raised_arm());
  EXPECT_TRUE(rig.run(kHolds)) << text_of(rig.report.refused);
  EXPECT_EQ(rig.report.loop.fault, 0u);
  EXPECT_EQ(rig.report.loop.ticks, 1000u);
  EXPECT_LT(rig.report.loop.slew_clamped, 50u);
}

TEST(SimulatedRun, ALawThatDoesNoWorseThanTheRobotAlonePasses) {
  Rig rig(raised_arm());
  EXPECT_TRUE(rig.run(kLimp)) << text_of(rig.report.refused);
  EXPECT_EQ(rig.report.loop.fault_tick, rig.setup.plain.baseline.fault_tick);
}

// What a run that was broken off early had to bear does not excuse all of a long one.
TEST(SimulatedRun, TheGuardsWorkIsComparedOverTheSameTime) {
  Rig rig(robot_of("arm.toml"));
  rig.setup.plain.baseline.ticks = 10;
  rig.setup.plain.baseline.velocity_clamped = rig.setup.plain.baseline.torque_clamped = 10;
  rig.setup.plain.baseline.slew_clamped = rig.setup.plain.baseline.position_clamped = 10;
  rig.setup.plain.baseline.fault = 1;
  rig.setup.plain.baseline.fault_tick = 10;
  EXPECT_FALSE(rig.run(kAsksTooMuch));
  EXPECT_GT(rig.report.loop.ticks, 50u) << "the guard stops it later than the baseline, so that only the share speaks";
  const std::string said = text_of(rig.report.refused);
  unsigned tick = 0;
  double wanted_nm = 0, given_nm = 0, at_rad = 0;
  const std::size_t words = said.find("), joint ");
  ASSERT_NE(words, std::string::npos) << said;
  EXPECT_EQ(std::sscanf(said.c_str() + words, "), joint %*s most of all (tick %u: wanted %lf N m, got %lf, at %lf rad",
                        &tick, &wanted_nm, &given_nm, &at_rad),
            4)
      << said;
  EXPECT_GT(tick, 0U) << said;
  EXPECT_EQ(wanted_nm, 2) << said;
  EXPECT_LE(given_nm, 0.6) << said;
  EXPECT_NE(said.find("; its limits are -3 and 3 rad)"), std::string::npos) << said;
  EXPECT_TRUE(Rig(robot_of("arm.toml")).run(kHolds));
}

// What a law must at least have lived through is a time, not a number of ticks. A run that was cut short is told.
TEST(SimulatedRun, ALawWithNoTimeLeftIsRiddenForATenthOfASecondAtEveryRateAndThatIsSaid) {
  for (const double rate_hz : {100.0, 250.0, 1000.0, 10'000.0}) {
    robot::RobotConfig robot = robot_of("arm.toml");
    robot.rate_hz = rate_hz;
    Rig rig(robot);
    EXPECT_TRUE(rig.run(kLimp, kNoTime)) << text_of(rig.report.refused);
    EXPECT_EQ(rig.report.loop.ticks, static_cast<std::uint32_t>(std::lround(rate_hz / 10)));
    EXPECT_EQ(rig.report.loop.whole_ticks, static_cast<std::uint32_t>(std::lround(rate_hz)));
    EXPECT_EQ(rig.report.rough.ticks, static_cast<std::uint32_t>(std::lround(rate_hz / 2)));
    const auto said = warnings(rig.report, rig.setup);
    ASSERT_GE(said.size(), 2u);
    EXPECT_EQ(said[0], "tried for 0.1 s only, not 1 s, in the gentle run: its steps use up the trial's box (--box)");
    EXPECT_EQ(said[1], "tried for 0.5 s only, not 1 s, in the rough run: its steps use up the trial's box (--box)");
  }
}

struct TooStiff : NoParamsNoState {  // for the chain: an oscillation that grows slowly
  static void step(const Tick& t, const Params&, State&, Effort& u) {
    for (std::uint32_t j = 0; j < t.joints; ++j)
      u.torque_nm[j] = 40 * (t.setpoint_position_rad[j] - t.position_rad[j]) +
                       0.1 * (t.setpoint_velocity_rad_s[j] - t.velocity_rad_s[j]);
  }
};
constexpr LitheLaw kTooStiff = describe<TooStiff>("too_stiff");

// However long the simulated robot takes: only the law's own steps count.
TEST(SimulatedRun, WhatGrowsSlowlyIsFoundOnASlowProcessorToo) {
  robot::RobotConfig chain = robot_of("chain.toml");
  chain.model.given = false;  // each joint's own guard slows this law's growth down; with a model 0.4 s show it
  Rig rig(chain);
  EXPECT_FALSE(rig.run(kTooStiff, 20'000'000));
  EXPECT_TRUE(Rig(chain).run(kTooStiff, kNoTime)) << "the least that a run lasts does not show it";
  EXPECT_NE(text_of(rig.report.refused).find("swings to and fro"), std::string::npos) << text_of(rig.report.refused);
}

// Each second of such a robot would take longer than a person waits.
TEST(SimulatedRun, ARobotThatTakesTooLongToSimulateIsRiddenShorterAndThatIsSaid) {
  Rig rig(robot_of("arm.toml"));
  rig.setup.plain.run_ticks = rig.setup.heavy.run_ticks = 700;
  EXPECT_TRUE(rig.run(kHolds)) << text_of(rig.report.refused);
  EXPECT_EQ(rig.report.loop.ticks, 700u);
  EXPECT_EQ(rig.report.rough.ticks, 700u);
  const auto said = warnings(rig.report, rig.setup);
  ASSERT_EQ(said.size(), 2u);
  EXPECT_EQ(said[0], "tried for 0.7 s only, not 1 s, in the gentle run: this robot takes too long to simulate");
}

struct Chatters : NoParamsNoState {  // below the slew bound, so that no other criterion sees it
  static void step(const Tick& t, const Params&, State&, Effort& u) {
    for (std::uint32_t j = 0; j < t.joints; ++j) {
      u.torque_nm[j] = 1.5 * (t.setpoint_position_rad[j] - t.position_rad[j]) - 0.08 * t.velocity_rad_s[j] +
                       (t.tick % 4 == 1   ? 0.07
                        : t.tick % 4 == 3 ? -0.07
                                          : 0.0);
    }
  }
};
// Stable, but only just: one tick more of delay, or a little more load, and it swings.
struct OnTheEdge : NoParamsNoState {
  static void step(const Tick& t, const Params&, State&, Effort& u) {
    for (std::uint32_t j = 0; j < t.joints; ++j)
      u.torque_nm[j] = 12 * (t.setpoint_position_rad[j] - t.position_rad[j]) - kDamping * t.velocity_rad_s[j];
  }
  static inline double kDamping = 0.08;
};
struct Lazy : NoParamsNoState {
  static void step(const Tick& t, const Params&, State&, Effort& u) {
    for (std::uint32_t j = 0; j < t.joints; ++j) u.torque_nm[j] = -0.001 * t.velocity_rad_s[j];
  }
};
constexpr LitheLaw kChatters = describe<Chatters>("chatters");
constexpr LitheLaw kOnTheEdge = describe<OnTheEdge>("on_the_edge");
constexpr LitheLaw kLazy = describe<Lazy>("lazy");

TEST(SimulatedRun, ALawWhoseTorqueJumpsUpAndDownIsRefusedWithItsJoint) {
  Rig rig(robot_of("arm.toml"));
  EXPECT_FALSE(rig.run(kChatters));
  EXPECT_EQ(rig.report.loop.tremor, 1u);
  EXPECT_NE(text_of(rig.report.refused).find("the torque of joint " + rig.setup.robot.joints[0].name + " jumps"),
            std::string::npos)
      << text_of(rig.report.refused);
}

// How little damping each run bears: the rough one asks for more.
TEST(SimulatedRun, TheRoughRunFindsALawThatIsOnlyJustStable) {
  double plain = 1, rough = 1;
  for (OnTheEdge::kDamping = 0.08; OnTheEdge::kDamping > 0; OnTheEdge::kDamping -= 0.004) {
    Rig rig(robot_of("arm.toml"));
    if (rig.run(kOnTheEdge)) rough = OnTheEdge::kDamping;
    if (rig.report.loop.ticks == 1000 && rig.report.loop.tremor == 0 && rig.report.loop.fault == 0)
      plain = OnTheEdge::kDamping;
  }
  std::printf("least damping at 12 N m/rad: %.3f on the plain run, %.3f on the rough one\n", plain, rough);
  EXPECT_GT(rough, plain + 0.001);
}

TEST(SimulatedRun, ALawThatIsNoBetterThanNoneIsWarnedOf) {
  Rig lazy(robot_of("arm.toml")), holds(robot_of("arm.toml"));
  ASSERT_TRUE(lazy.run(kLazy)) << text_of(lazy.report.refused);
  ASSERT_FALSE(warnings(lazy.report, lazy.setup).empty());
  EXPECT_NE(warnings(lazy.report, lazy.setup)[0].find(lazy.setup.robot.joints[0].name), std::string::npos);
  ASSERT_TRUE(holds.run(kHolds)) << text_of(holds.report.refused);
  EXPECT_TRUE(warnings(holds.report, holds.setup).empty());
}

TEST(SimulatedRun, BothRunsAreTheSameEachTime) {
  Rig one(robot_of("arm.toml")), other(robot_of("arm.toml"));
  EXPECT_TRUE(one.run(kHolds));
  EXPECT_TRUE(other.run(kHolds));
  EXPECT_EQ(one.report.loop.rms_error_rad, other.report.loop.rms_error_rad);
  EXPECT_EQ(one.report.rough.rms_error_rad, other.report.rough.rms_error_rad);
  EXPECT_NE(one.report.rough.rms_error_rad, one.report.loop.rms_error_rad);
}

// What a law sees of joint 0 in each of the two runs: how much a value jumps from tick to tick (second differences),
// and the mean error of the last third.
struct Seen {
  std::array<double, 3> position_rad{}, velocity_rad_s{};
  double position_jumps = 0, velocity_jumps = 0, error_rad = 0;
  int ticks = 0, late_ticks = 0;

  static void push(std::array<double, 3>& last, double value, double& jumps, int ticks) {
    last = {value, last[0], last[1]};
    if (ticks >= 2) jumps += std::pow(last[0] - 2 * last[1] + last[2], 2);
  }
  double jump(double jumps) const { return std::sqrt(jumps / ticks); }
};
std::array<Seen, 2> g_seen;
int g_run = -1;
std::uint64_t g_tick = ~0ull;
struct Looks : NoParamsNoState {
  static void step(const Tick& t, const Params&, State&, Effort& u) {
    if (t.tick < g_tick) ++g_run;
    g_tick = t.tick;
    Seen& seen = g_seen.at(static_cast<std::size_t>(std::clamp(g_run, 0, 1)));
    Seen::push(seen.position_rad, t.position_rad[0], seen.position_jumps, seen.ticks);
    Seen::push(seen.velocity_rad_s, t.velocity_rad_s[0], seen.velocity_jumps, seen.ticks);
    if (++seen.ticks > 650) {
      seen.error_rad += t.setpoint_position_rad[0] - t.position_rad[0];
      ++seen.late_ticks;
    }
    Holds::State none;
    Holds::step(t, {}, none, u);
  }
};

TEST(SimulatedRun, TheRoughRunHasNoiseAndAPayload) {
  constexpr LitheLaw kLooks = describe<Looks>("looks");
  Rig rig(raised_arm());
  EXPECT_TRUE(rig.run(kLooks)) << text_of(rig.report.refused);
  ASSERT_EQ(g_run, 1) << "a plain run and a rough one";
  const Seen &plain = g_seen[0], &rough = g_seen[1];
  ASSERT_GT(plain.late_ticks, 100);
  ASSERT_GT(rough.late_ticks, 100);
  // What independent noise adds to the mean square of a second difference: 6 of its variance.
  const auto added = [](double with, double without) { return std::sqrt((with * with - without * without) / 6); };
  EXPECT_NEAR(added(rough.jump(rough.velocity_jumps), plain.jump(plain.velocity_jumps)), 0.02, 0.01);
  EXPECT_NEAR(added(rough.jump(rough.position_jumps), plain.jump(plain.position_jumps)), 2e-4, 1e-4);
  const double plain_rad = plain.error_rad / plain.late_ticks, rough_rad = rough.error_rad / rough.late_ticks;
  EXPECT_GT(rough_rad / plain_rad, 1.1) << "a fifth more weight: " << plain_rad << ", " << rough_rad;
}

Tick g_last;
struct Remembers : NoParamsNoState {
  static void step(const Tick& t, const Params&, State&, Effort&) { g_last = t; }
};

TEST(SimulatedRun, ALawSeesWhatTheSensorsOfTheRobotMeasure) {
  constexpr LitheLaw kRemembers = describe<Remembers>("remembers");
  Rig rig(robot_of("frankenstein.toml"));
  EXPECT_TRUE(rig.run(kRemembers)) << text_of(rig.report.refused);
  const std::size_t sensors = rig.setup.robot.sensors.size();
  ASSERT_GT(sensors, 0u);
  for (std::size_t i = 0; i < kMaxSensors; ++i) EXPECT_EQ(std::isfinite(g_last.sensor[i]), i < sensors) << i;
  EXPECT_NEAR(g_last.sample_age_s, rig.setup.dt_s(), 1e-12);
  Rig(robot_of("arm.toml")).run(kRemembers);
  EXPECT_TRUE(std::isnan(g_last.sensor[0])) << "there is none";
}

}  // namespace
}  // namespace lithe::trial
