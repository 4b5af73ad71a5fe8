// SPDX-License-Identifier: Apache-2.0
// What the guard itself does with a joint, in each mode of a CiA 402 drive, inside and outside the joint's limits:
// nothing leaps, and nothing shakes.
#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <string>
#include <utility>

#include "spine/loop/test/recover_rig.hpp"

namespace lithe::loop {
namespace {

using CiaMode = hal::cia402::Mode;

// For every mode: a torque by the drive's gains, a target for its own loop.
struct FollowAll {
  struct Params {};
  struct State {};
  static void step(const Tick& t, const Params&, State&, Effort& u) {
    for (std::uint32_t j = 0; j < t.joints; ++j) {
      u.position_rad[j] = t.setpoint_position_rad[j];
      u.velocity_rad_s[j] = t.setpoint_velocity_rad_s[j];
      u.kp_nm_rad[j] = 4.0;
      u.kd_nm_s_rad[j] = 0.1;
    }
  }
};
struct StepAll {  // the same, but a drive that closes a loop of velocity is led to the setpoint's position
  struct Params {};
  struct State {};
  static void step(const Tick& t, const Params&, State&, Effort& u) {
    FollowAll::State none;
    FollowAll::step(t, {}, none, u);
    for (std::uint32_t j = 0; j < t.joints; ++j)
      u.velocity_rad_s[j] += 5 * (t.setpoint_position_rad[j] - t.position_rad[j]);
  }
};
struct RunAway {  // as fast as it may, for ever
  struct Params {};
  struct State {
    double target_rad = 0;
    double started = 0;
  };
  static void step(const Tick& t, const Params&, State& s, Effort& u) {
    if (s.started == 0) s.target_rad = t.position_rad[0];
    s.started = 1;
    s.target_rad += 3.0 * t.dt_s;
    u.position_rad[0] = s.target_rad;
    u.velocity_rad_s[0] = 3.0;
    u.kp_nm_rad[0] = 4.0;
    u.kd_nm_s_rad[0] = 0.1;
  }
};
inline constexpr LitheLaw kFollowAll = describe<FollowAll>("follow");
inline constexpr LitheLaw kStepAll = describe<StepAll>("step");
inline constexpr LitheLaw kRunAway = describe<RunAway>("run_away");

constexpr CiaMode kModes[] = {CiaMode::torque, CiaMode::velocity, CiaMode::position};
constexpr double kFastRadS = 4.0, kSlowingRadS2 = 20.0;

robot::RobotConfig robot_in(CiaMode mode, robot::SafeEnd end, const std::vector<JointText>& joints) {
  robot::RobotConfig robot = robot_of(1000, joints);
  robot.guard.safe_end = end;
  constexpr double kRatio = 20;  // else a count is a step of 1.5 mrad
  for (robot::DeviceConfig& device : robot.devices) {
    device.keys.cia402.mode = mode;
    device.keys.cia402.rated_torque_nm /= kRatio;
  }
  for (robot::JointConfig& joint : robot.joints) {
    joint.ratio = kRatio;
    joint.velocity_max_rad_s = kFastRadS;
    joint.kp_max_nm_rad = 50;
    joint.kd_max_nm_s_rad = 1;
    joint.safe_kp_nm_rad = 4.0;
  }
  return robot;
}

struct Draw {
  explicit Draw(std::uint64_t seed) : bits(static_cast<std::mt19937::result_type>(seed)) {}
  double uniform() { return std::uniform_real_distribution<double>(0, 1)(bits); }
  std::mt19937 bits;
};

struct OwnRig : RecoverBench {
  // `believed`: what the guard takes the drives for. Another one is the broken twin.
  OwnRig(CiaMode mode, CiaMode believed, robot::SafeEnd end, const std::vector<JointText>& joints)
      : RecoverBench(robot_in(believed, end, joints),
                     std::move(*hal::sim::open_actuators(robot_in(mode, end, joints)))) {
    stage(kFollowAll);
    ticks(1500);  // boot and configuration, if it is beyond 607Dh twice
  }
  double q(std::size_t j = 0) const { return record_.position_rad[j]; }
  double v(std::size_t j = 0) const { return record_.velocity_rad_s[j]; }
  // One tick in which the drive of joint `j` reports a fault.
  void fail(std::size_t j) {
    tick(false);
    actuators_->cycle(sent_ = handover_.command(), handover_.sample(), now_ns_);
    handover_.sample().status[j] |= wire::joint_status::kFault;
    handover_.finish();
    tick();
  }
  using TickBench::record_;
  using TickBench::sent_;
};

// How a joint moved since its stop.
struct Moved {
  double speed_rad_s = 0;   // the fastest
  double way_rad = 0;       // the farthest from where it was
  double shakes_rad_s = 0;  // the fastest, once it had a second to come to rest
};
Moved moved_in(OwnRig& rig, double seconds) {
  Moved seen;
  const double from_rad = rig.q();
  for (int i = 0; i < rig.ticks_in(seconds); ++i) {
    rig.tick();
    seen.speed_rad_s = std::max(seen.speed_rad_s, std::abs(rig.v()));
    seen.way_rad = std::max(seen.way_rad, std::abs(rig.q() - from_rad));
    if (i > rig.ticks_in(1.0)) seen.shakes_rad_s = std::max(seen.shakes_rad_s, std::abs(rig.v()));
  }
  return seen;
}

// Recover from a drawn place beyond a limit, then a stop there or on the way, or none. "" = as it must be.
std::string recover_run(CiaMode mode, CiaMode believed, std::uint64_t seed) {
  Draw random(seed);
  const auto end = random.uniform() < 0.5 ? robot::SafeEnd::hold : robot::SafeEnd::damp;
  const double from_rad = 0.05 + 0.95 * random.uniform(), mgl_nm = 0.2 * random.uniform();
  const bool below = random.uniform() < 0.5;  // it hangs at 0, beyond this end of its range
  const double min_rad = below ? from_rad : -from_rad - 2;
  OwnRig rig(mode, believed, end, {{min_rad, min_rad + 2, 0, mgl_nm, robot::DeviceKind::cia402}});
  const std::string where = fmt::format("seed {}, range from {:.2f} rad, mgl {:.2f}", seed, min_rad, mgl_nm);
  if (rig.send(CommandKind::recover) != CommandResult::done) return where + ": recover is refused";
  const bool stops = random.uniform() < 0.5;
  const int stop_after = static_cast<int>(random.uniform() * 2000);
  double fastest = 0, most_nm = 0;
  for (int i = 0; i < rig.ticks_in(15) && rig.recovering() && !(stops && i >= stop_after); ++i) {
    rig.tick();
    fastest = std::max(fastest, std::abs(rig.v()));
    most_nm = std::max(most_nm, std::abs(rig.record_.torque_nm[0]));
    if (rig.mode() != Mode::recover) return where + ": it ended";
  }
  if (fastest > 1.5 * kRecoverRadS) return where + fmt::format(": {:.2f} rad/s", fastest);
  if (most_nm > 1.05 * kRecoverShare * kTorqueMaxNm) return where + fmt::format(": {:.3f} N m", most_nm);
  if (!stops) {
    if (!rig.inside(0)) return where + fmt::format(": it is at {:.3f} rad", rig.q());
    const Moved held = moved_in(rig, 2);
    return held.way_rad > 0.05 || held.shakes_rad_s > 0.05 ? where + ": it is not held inside" : "";
  }
  const bool was_outside = !rig.inside(0);
  rig.fail(0);
  const Moved seen = moved_in(rig, 2);
  if (seen.speed_rad_s > 1.5 * kRecoverRadS) return where + fmt::format(": stopped, {:.2f} rad/s", seen.speed_rad_s);
  if (was_outside && seen.way_rad > 0.1) return where + fmt::format(": stopped, and moved by {:.2f} rad", seen.way_rad);
  return seen.shakes_rad_s > 0.05 ? where + fmt::format(": it shakes, {:.2f} rad/s", seen.shakes_rad_s) : "";
}

// A moving joint is stopped inside its limits: by a fault of its drive, or of another group.
std::string stop_run(CiaMode mode, CiaMode believed, std::uint64_t seed) {
  Draw random(seed);
  const auto end = random.uniform() < 0.5 ? robot::SafeEnd::hold : robot::SafeEnd::damp;
  OwnRig rig(mode, believed, end, {{-3, 3, -0.5, 0.15 * random.uniform(), robot::DeviceKind::cia402}});
  if (rig.send(CommandKind::arm) != CommandResult::done) return "not armed";
  rig.ticks(500);
  rig.publish(0.5, 300 + static_cast<int>(600 * random.uniform()));
  rig.ticks(static_cast<int>(500 * random.uniform()));
  const double before = std::abs(rig.v());
  const std::string where = fmt::format("seed {}, at {:.2f} rad/s", seed, rig.v());
  rig.fail(0);
  const Moved seen = moved_in(rig, 2);
  if (rig.mode() != Mode::safe_stop) return where + ": it does not stop";
  if (seen.speed_rad_s > before + 0.5) return where + fmt::format(": {:.2f} rad/s after the stop", seen.speed_rad_s);
  const double way_rad = before * before / (2 * kSlowingRadS2) + 0.15;
  if (seen.way_rad > way_rad) return where + fmt::format(": {:.2f} rad after the stop", seen.way_rad);
  return seen.shakes_rad_s > 0.1 ? where + fmt::format(": it shakes, {:.2f} rad/s", seen.shakes_rad_s) : "";
}

// A policy's steps, anywhere within the limits; then a stop, a few ticks after one of them. (By torque a joint may be
// faster then: its torque cannot end at once, and it falls.)
std::string step_run(CiaMode mode, CiaMode believed, std::uint64_t seed) {
  Draw random(seed);
  const auto end = random.uniform() < 0.5 ? robot::SafeEnd::hold : robot::SafeEnd::damp;
  OwnRig rig(mode, believed, end, {{-1, 1, 0, 0.15 * random.uniform(), robot::DeviceKind::cia402}});
  if (mode == CiaMode::velocity) rig.stage(kStepAll);
  if (rig.send(CommandKind::arm) != CommandResult::done) return "not armed";
  rig.ticks(500);
  const std::string where = fmt::format("seed {}", seed);
  double moved_rad = 0, last_rad = rig.q();
  for (int step = 0; step < 30; ++step) {
    rig.publish(2 * random.uniform() - 1, 0, wire::Interpolation::hold);
    const int pause = step == 29 ? 5 : 20 + static_cast<int>(60 * random.uniform());
    for (int i = 0; i < pause; ++i) {
      rig.tick();
      if (std::abs(rig.q()) > 1.1) return where + fmt::format(": at {:.3f} rad, limit 1", rig.q());
      moved_rad += std::abs(rig.q() - std::exchange(last_rad, rig.q()));
    }
    if (rig.mode() != Mode::active) return where + ": it is stopped";
  }
  if (moved_rad < 0.3) return where + ": it does not follow";
  const double before = std::abs(rig.v());
  rig.fail(0);
  const Moved seen = moved_in(rig, 2);
  if (rig.record_.setpoint_position_rad[0] != rig.q()) return where + ": the setpoint is not where the joint is";
  if (mode == CiaMode::torque) return "";
  if (seen.speed_rad_s > before + 0.5) return where + fmt::format(": {:.2f} rad/s after the stop", seen.speed_rad_s);
  const double way_rad = before * before / (2 * kSlowingRadS2) + 0.15;
  return seen.way_rad > way_rad ? where + fmt::format(": {:.2f} rad after the stop", seen.way_rad) : "";
}

struct Tally {
  int runs = 0, wrong = 0;
  std::string first;
  void add(const std::string& why) {
    ++runs;
    if (why.empty()) return;
    if (wrong++ == 0) first = why;
  }
};
constexpr int kOwnRuns = 40;

Tally run_all(std::string (*run)(CiaMode, CiaMode, std::uint64_t), CiaMode mode, CiaMode believed) {
  Tally count;
  for (int seed = 1; seed <= kOwnRuns; ++seed) count.add(run(mode, believed, static_cast<std::uint64_t>(seed)));
  return count;
}

TEST(OwnLoop, RecoverIsSlowAndAStopInItLeapsInNoModeOfTheDrive) {
  for (const CiaMode mode : {CiaMode::velocity, CiaMode::position}) {
    const Tally count = run_all(recover_run, mode, mode);
    EXPECT_EQ(count.wrong, 0) << static_cast<int>(mode) << ": " << count.wrong << " of " << count.runs << ", "
                              << count.first;
    const Tally twin = run_all(recover_run, mode, CiaMode::torque);
    EXPECT_GT(twin.wrong, kOwnRuns / 4) << static_cast<int>(mode) << ": a torque for a drive that closes its own loop";
  }
}

TEST(OwnLoop, AStopOfAMovingJointLeapsInNoModeOfTheDrive) {
  for (const CiaMode mode : {CiaMode::velocity, CiaMode::position}) {
    const Tally count = run_all(stop_run, mode, mode);
    EXPECT_EQ(count.wrong, 0) << static_cast<int>(mode) << ": " << count.wrong << " of " << count.runs << ", "
                              << count.first;
  }
}

TEST(OwnLoop, StepsOfTheSetpointLeadNoDriveBeyondALimitAndASafeStopFollowsNone) {
  for (const CiaMode mode : kModes) {
    const Tally count = run_all(step_run, mode, mode);
    EXPECT_EQ(count.wrong, 0) << static_cast<int>(mode) << ": " << count.wrong << " of " << count.runs << ", "
                              << count.first;
  }
}

TEST(OwnLoop, ALawThatRunsIntoALimitIsStoppedThereInEachMode) {
  for (const CiaMode mode : kModes) {
    OwnRig rig(mode, mode, robot::SafeEnd::hold, {{-1, 1, 0, 0.05, robot::DeviceKind::cia402}});
    ASSERT_EQ(rig.send(CommandKind::arm), CommandResult::done);
    rig.ticks(200);
    rig.stage(kRunAway);
    double farthest = 0;
    for (int i = 0; i < 3000; ++i) {
      rig.tick();
      farthest = std::max(farthest, rig.q());
    }
    EXPECT_GT(farthest, 0.8) << static_cast<int>(mode);
    EXPECT_LT(farthest, 1.1) << static_cast<int>(mode) << ": " << farthest;
    EXPECT_LT(std::abs(rig.v()), 0.05) << static_cast<int>(mode);
  }
}

}  // namespace
}  // namespace lithe::loop
