// SPDX-License-Identifier: Apache-2.0
// No joint leaves its limits, whatever the law does: thousands of adversaries between random limits, at random rates,
// with random loads within what the robot file declares.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <map>
#include <ostream>
#include <random>
#include <string>

#include "spine/robot/limits/stopping.hpp"
#include "spine/robot/robot.hpp"
#include "tests/limits/rig.hpp"

namespace lithe::limits {
namespace {

robot::RobotConfig load(const std::string& name) {
  Result<robot::RobotConfig> robot = robot::load_robot(std::string(LITHE_ROBOTS) + "/" + name + ".toml");
  EXPECT_TRUE(robot) << robot.message();
  return *robot;
}

// One joint of a robot whose joints do not know of each other.
robot::RobotConfig alone(const robot::RobotConfig& robot, std::size_t joint) {
  robot::RobotConfig one = robot;
  one.joints = {robot.joints[joint]};
  one.devices = {robot.devices[robot.joints[joint].device]};
  one.joints[0].device = 0;
  return one;
}

struct Dice {
  explicit Dice(std::uint64_t seed) : random(seed) {}
  double between(double low, double high) { return std::uniform_real_distribution<double>(low, high)(random); }
  bool one_in(int n) { return random() % static_cast<std::uint64_t>(n) == 0; }
  std::mt19937_64 random;
};

void shuffle_limits(robot::JointConfig& joint, Dice& dice) {
  const double range = joint.position_max_rad - joint.position_min_rad;
  const double wide = range * dice.between(0.3, 1.0);
  joint.position_min_rad += dice.between(0, range - wide);
  joint.position_max_rad = joint.position_min_rad + wide;
  joint.sim.initial_position_rad = joint.position_min_rad + wide * dice.between(0.1, 0.9);
}

void shuffle_time(Run& run, Dice& dice) {
  constexpr std::array kRates{250.0, 500.0, 1000.0, 1000.0, 1000.0, 2000.0, 4000.0, 10'000.0};
  run.robot.rate_hz = kRates[dice.random() % kRates.size()];
  run.transport_thread = dice.one_in(2);
  run.late_bus = dice.one_in(5);
  if (dice.one_in(5)) run.stop_at_s = dice.between(0, run.seconds);
}

// Safe gains that a robot file may have at this rate: the reader refuses what leaves less than 20 degrees of phase
// margin.
void settle_safe_gains(robot::RobotConfig& robot) {
  for (robot::JointConfig& joint : robot.joints) {
    const double period_s = robot::drive_period_s(robot, joint);
    const double delay_s = robot::reaction_s(robot, joint) + 1 / robot.rate_hz + 0.5 * period_s;
    const auto shakes = [&](double kp, double kd) {
      return robot::phase_margin_rad(joint.inertia_min_kg_m2, kp, kd, delay_s) < 0.35;
    };
    while (shakes(0, joint.safe_kd_nm_s_rad)) joint.safe_kd_nm_s_rad *= 0.9;
    while (joint.safe_kp_nm_rad > 0 && shakes(joint.safe_kp_nm_rad, joint.safe_kd_nm_s_rad))
      joint.safe_kp_nm_rad = joint.safe_kp_nm_rad > 1e-6 ? 0.9 * joint.safe_kp_nm_rad : 0;
  }
}

// What a drive costs that is not asked in every tick, and whose encoder is noisy. Each is asked at least `least_hz`
// times a second: where it is less, more acts on a light joint between two commands than the guard can make good.
void shuffle_drives(Run& run, Dice& dice, double least_hz) {
  constexpr std::array kDividers{1u, 1u, 2u, 4u};
  constexpr double kNoiseRad = 2.6e-4;  // of a magnetic encoder: docs/reference/plants.md
  run.noise = dice.one_in(2);
  for (robot::DeviceConfig& device : run.robot.devices) {
    device.rate_divider = kDividers[dice.random() % 4];
    while (run.robot.rate_hz / device.rate_divider < least_hz) device.rate_divider /= 2;
  }
  for (robot::JointConfig& joint : run.robot.joints)
    if (joint.sim.encoder_noise_rad == 0) joint.sim.encoder_noise_rad = kNoiseRad / joint.ratio;
  settle_safe_gains(run.robot);
}

Run a_run(const robot::RobotConfig& robot, std::uint64_t seed) {
  Dice dice(seed);
  Run run;
  run.seed = seed;
  run.adversary = static_cast<Adversary>(seed % kAdversaries);
  run.robot = robot.plant.kind == robot::PlantKind::chain ? robot : alone(robot, dice.random() % robot.joints.size());
  run.robot.spine.late_ticks_to_stop = 20;
  run.robot.guard.soft_start_s = dice.one_in(5) ? 0.1 : 0;
  run.seconds = 0.5;
  shuffle_time(run, dice);
  for (robot::JointConfig& joint : run.robot.joints) {
    shuffle_limits(joint, dice);
    if (robot.plant.kind == robot::PlantKind::chain) continue;
    joint.sim.inertia_kg_m2 = dice.between(joint.inertia_min_kg_m2, joint.inertia_max_kg_m2);
    joint.sim.mgl_nm = dice.between(0, joint.load_max_nm);
    run.bias_nm.push_back((joint.load_max_nm - joint.sim.mgl_nm) * dice.between(-1, 1));
  }
  shuffle_drives(run, dice, 250);
  return run;
}

struct Tally {
  std::uint64_t runs = 0, ticks = 0, outside = 0, too_fast = 0;
  Extremes most;
  std::map<std::string, double> worst_rad;  // by adversary
};

void leave_as_it_is(Run&) {}
void miss_answers(Run& run) { run.missed_answers = true; }
void forget_model(Run& run) { run.robot.model.given = false; }
void never_dispatch(Run& run) { run.never_dispatched = true; }
void forget_inertia(Run& run) {
  forget_model(run);
  for (robot::JointConfig& joint : run.robot.joints) joint.inertia_max_kg_m2 = 0;
}

Tally tally(const robot::RobotConfig& robot, std::uint64_t from, std::uint64_t runs,
            void (*change)(Run&) = leave_as_it_is) {
  Tally all;
  for (std::uint64_t seed = from; seed < from + runs; ++seed) {
    Run run = a_run(robot, seed);
    change(run);
    const Extremes extremes = play(run);
    ++all.runs;
    all.ticks += extremes.ticks;
    all.outside += extremes.overrun_rad > 0;
    all.too_fast += extremes.speed_share >= 1;
    all.most.overrun_rad = std::max(all.most.overrun_rad, extremes.overrun_rad);
    all.most.speed_share = std::max(all.most.speed_share, extremes.speed_share);
    all.most.step_share = std::max(all.most.step_share, extremes.step_share);
    all.most.promise_share = std::max(all.most.promise_share, extremes.promise_share);
    double& worst = all.worst_rad.try_emplace(std::string(name_of(run.adversary)), -1e9).first->second;
    worst = std::max(worst, extremes.overrun_rad);
    if (extremes.overrun_rad > 0.01 || extremes.speed_share > 1 || extremes.step_share > 1.5) {
      std::printf("  run %lu: %s of %s at %g Hz / %u%s: %.4f rad beyond, %.3f of the fault's speed, %.2f slew steps\n",
                  seed, name_of(run.adversary).data(), run.robot.joints[0].name.c_str(), run.robot.rate_hz,
                  run.robot.devices[0].rate_divider, run.noise ? ", noise" : "", extremes.overrun_rad,
                  extremes.speed_share, extremes.step_share);
    }
  }
  std::printf(
      "%s: %lu runs, %lu ticks; farthest %.4f rad beyond a limit (%lu runs beyond), fastest %.3f of the speed that "
      "is a fault (%lu runs above), largest step %.3f of slew\n",
      robot.name.c_str(), all.runs, all.ticks, all.most.overrun_rad, all.outside, all.most.speed_share, all.too_fast,
      all.most.step_share);
  for (const auto& [name, over] : all.worst_rad) std::printf("  %-15s %.4f\n", name.c_str(), over);
  return all;
}

// Ten thousand runs, in parts that a slow machine has time for.
struct Part {
  const char* robot;
  std::uint64_t from;
};
constexpr std::uint64_t kRuns = 1000;
void PrintTo(const Part& part, std::ostream* out) { *out << part.robot << " from run " << part.from; }

// At the joint a step of the torque may be twice the slew bound when the guard knows the model (docs/adr/0026).
constexpr double kMostStep = 2;
// A guard without a model promises the slew bound where it expects the joint; the age of a sample is in whole ns.
constexpr double kPromised = 1.001;

// No run beyond a position limit or the speed that is a fault. Light joints of frankenstein that are asked 250 times a
// second gain too much speed within one period for that (docs/adr/0014): of the same runs with a guard that looks at
// the limit only, a hundredth may be beyond, and none so far that the position itself is a fault.
void expect_within(const robot::RobotConfig& robot, std::uint64_t from, std::uint64_t runs) {
  const Tally all = tally(robot, from, runs);
  if (robot.model.given)
    EXPECT_LE(all.most.step_share, kMostStep);
  else
    EXPECT_LE(all.most.promise_share, kPromised);
  if (robot.name != "frankenstein") {
    EXPECT_EQ(all.outside, 0U);
    EXPECT_EQ(all.too_fast, 0U);
    return;
  }
  const Tally twin = tally(robot, from, runs, forget_inertia);
  EXPECT_LE(100 * all.outside, twin.outside);
  EXPECT_LE(100 * all.too_fast, twin.too_fast);
  EXPECT_LT(all.most.overrun_rad, robot.guard.position_overrun_rad);
}

class Limits : public testing::TestWithParam<Part> {};

TEST_P(Limits, NoJointLeavesThemWhateverTheLawDoes) {
  const robot::RobotConfig robot = load(GetParam().robot);
  expect_within(robot, GetParam().from, kRuns / LITHE_LIMITS_SHARE);
}

// A minute: `make check-all`, or --gtest_also_run_disabled_tests --gtest_filter='LimitsLong*'.
TEST(LimitsLong, DISABLED_TwentyThousandRunsOfEachRobot) {
  for (const char* name : {"arm", "chain", "frankenstein"}) {
    const robot::RobotConfig robot = load(name);
    expect_within(robot, robot.model.given ? 1'000'001 : 100'001, 20 * kRuns);
  }
}

INSTANTIATE_TEST_SUITE_P(Robots, Limits,
                         testing::Values(Part{"arm", 1}, Part{"arm", 1001}, Part{"arm", 2001}, Part{"arm", 3001},
                                         Part{"chain", 800'001}, Part{"frankenstein", 1}, Part{"frankenstein", 1001},
                                         Part{"frankenstein", 2001}, Part{"frankenstein", 3001},
                                         Part{"frankenstein", 4001}));

TEST(LimitsTwin, WithoutStoppingDistanceIsCaught) {
  for (const char* name : {"arm", "chain", "frankenstein"}) {
    const Tally all = tally(load(name), 1, 60, forget_inertia);
    EXPECT_GT(all.outside, all.runs / 4) << name;
    EXPECT_GT(all.too_fast, 0U) << name;
  }
}

TEST(LimitsTwin, AChainWithoutItsModelIsTooFast) {
  const robot::RobotConfig robot = load("chain");
  const Tally all = tally(robot, 500'001, 60, forget_model);
  EXPECT_GT(all.too_fast, 0U);
  EXPECT_GT(all.most.step_share, kMostStep);
}

TEST(LimitsTwin, AnObserverThatKnowsNoCommandsIsCaught) {
  const robot::RobotConfig robot = load("chain");
  EXPECT_GT(tally(robot, 500'001, 60, never_dispatch).most.step_share, kMostStep);
}

// The file is wrong by up to a quarter of each mass and inertia and a tenth of each centre, the drives by 5 %, and up
// to 30 g of payload are not in it.
void be_wrong(Run& run) {
  run.model_error = 0.25;
  run.gain_error = 0.05;
  run.payload_kg = 0.03;
}
void be_wrong_and_miss_answers(Run& run) {
  be_wrong(run);
  run.missed_answers = true;
}

// What is asked of a chain whose file is wrong or whose answers are missing. Of 20,000 runs `outside` may pass a
// limit of position, by `beyond_rad`.
struct Hard {
  const char* name;
  void (*change)(Run&);
  std::uint64_t outside;
  double beyond_rad, speed_share, step_share;
};
constexpr double kAnySpeed = 1e9;
constexpr std::array kHard{Hard{"wrong model", be_wrong, 2, 0.01, 1, kMostStep},
                           Hard{"missing answers", miss_answers, 0, 0, 1, kMostStep},
                           Hard{"both", be_wrong_and_miss_answers, 20 * kRuns, 0.01, kAnySpeed, 2.7}};

void expect_hard(const Hard& hard, std::uint64_t from, std::uint64_t runs) {
  SCOPED_TRACE(hard.name);
  const Tally all = tally(load("chain"), from, runs, hard.change);
  EXPECT_LE(all.outside, hard.outside);
  EXPECT_LE(all.most.overrun_rad, hard.beyond_rad);
  EXPECT_LE(all.most.speed_share, hard.speed_share);
  EXPECT_LE(all.most.step_share, hard.step_share);
}

TEST(LimitsModel, AChainStaysInsideWhenItsModelIsWrongAndAnswersAreMissing) {
  for (const Hard& hard : kHard) expect_hard(hard, 900'001, kRuns / LITHE_LIMITS_SHARE / 4);
}

TEST(LimitsLong, DISABLED_TwentyThousandRunsOfAChainWithEachError) {
  for (const Hard& hard : kHard) expect_hard(hard, 1'100'001, 20 * kRuns);
}

TEST(LimitsMissed, AnArmStaysInsideWhenUpToEightAnswersInARowAreLost) {
  const robot::RobotConfig robot = load("arm");
  const Tally all = tally(robot, 1, 2 * kRuns / LITHE_LIMITS_SHARE, miss_answers);
  EXPECT_EQ(all.outside, 0U);
  EXPECT_EQ(all.too_fast, 0U);
  EXPECT_LE(all.most.promise_share, kPromised);
}

// Whether a joint that its brake lets go of can still be stopped on this way, when the first torque acts.
bool can_be_caught(const robot::RobotConfig& robot, const robot::JointConfig& joint, double way_rad) {
  const double blind_s = robot::reaction_s(robot, joint) + 2 / robot.rate_hz, period_s = drive_period_s(robot, joint);
  const robot::Stop fall = stop_of(brakes_of(joint), 0, {0, blind_s}, {0, period_s});
  return 1.5 * fall.way_rad < way_rad && fall.peak_rad_s < joint.velocity_max_rad_s;
}

// A joint of a short range, outside of it on either side, with a load that pulls it inwards: up to the declared one,
// which may be more than recover's own torque.
Run a_recovery(const robot::RobotConfig& robot, std::uint64_t seed) {
  constexpr std::array kRates{500.0, 1000.0, 1000.0, 2000.0};
  Dice dice(seed);
  Run run;
  run.seed = seed;
  run.recover = true;
  run.robot = alone(robot, dice.random() % robot.joints.size());
  run.robot.rate_hz = kRates[dice.random() % kRates.size()];
  run.transport_thread = dice.one_in(2);
  run.seconds = 6;
  robot::JointConfig& joint = run.robot.joints[0];
  const double inward = dice.one_in(2) ? -1 : 1, wide = dice.between(0.3, 1.0), out = dice.between(0.01, 0.5);
  joint.position_min_rad = dice.between(-1, 1);
  joint.position_max_rad = joint.position_min_rad + wide;
  joint.sim.initial_position_rad = inward < 0 ? joint.position_max_rad + out : joint.position_min_rad - out;
  joint.sim.inertia_kg_m2 = dice.between(joint.inertia_min_kg_m2, joint.inertia_max_kg_m2);
  joint.sim.mgl_nm = 0;
  joint.load_max_nm = joint.torque_max_nm * dice.between(0.2, 0.85);
  shuffle_drives(run, dice, 500);
  while (!can_be_caught(run.robot, joint, wide + out)) joint.load_max_nm *= 0.9;
  run.bias_nm = {inward * joint.load_max_nm * dice.between(0, 1)};
  return run;
}

TEST(LimitsRecover, NoJointRunsThroughToItsOtherLimitAndAllEndInside) {
  int heavy = 0;
  for (const char* name : {"arm", "frankenstein"}) {
    const robot::RobotConfig robot = load(name);
    double opposite_rad = -1e9, end_rad = -1e9;
    for (std::uint64_t seed = 1; seed <= 200 / std::min(LITHE_LIMITS_SHARE, 20); ++seed) {
      const limits::Run run = a_recovery(robot, seed);
      const robot::JointConfig& joint = run.robot.joints[0];
      heavy += std::abs(run.bias_nm[0]) > run.robot.guard.recover_torque_share * joint.torque_max_nm;
      const Extremes extremes = play(run);
      opposite_rad = std::max(opposite_rad, extremes.opposite_rad);
      end_rad = std::max(end_rad, extremes.end_rad);
      if (extremes.opposite_rad > 0 || extremes.end_rad > 0 || extremes.fault != wire::Fault::none) {
        std::printf("  run %lu: %s of %s at %g Hz / %u: %.4f rad beyond the other limit, %.4f beyond at the end, %s\n",
                    seed, name, joint.name.c_str(), run.robot.rate_hz, run.robot.devices[0].rate_divider,
                    extremes.opposite_rad, extremes.end_rad, wire::to_string(extremes.fault).data());
      }
    }
    std::printf("%s: nearest to the other limit %.4f rad inside, at the end %.4f\n", name, -opposite_rad, -end_rad);
    EXPECT_LE(opposite_rad, 0) << name;
    EXPECT_LE(end_rad, guard::Recovery::kAtLimitRad) << name;
  }
  EXPECT_GT(heavy, 0) << "loads that recover's own torque does not hold";
}

// All joints of a chain outside of narrow limits, each on either side.
TEST(LimitsRecover, AChainWithAModelEndsInside) {
  double opposite_rad = -1e9, end_rad = -1e9, speed_share = 0;
  for (std::uint64_t seed = 1; seed <= 100 / std::min(LITHE_LIMITS_SHARE, 20); ++seed) {
    Dice dice(seed);
    limits::Run run;
    run.seed = seed;
    run.recover = true;
    run.robot = load("chain");
    run.transport_thread = dice.one_in(2);
    run.seconds = 8;
    for (robot::JointConfig& joint : run.robot.joints) {
      shuffle_limits(joint, dice);
      const double out = dice.between(0.05, 0.4);
      joint.sim.initial_position_rad = dice.one_in(2) ? joint.position_max_rad + out : joint.position_min_rad - out;
    }
    const Extremes extremes = play(run);
    EXPECT_EQ(extremes.fault, wire::Fault::none) << "run " << seed;
    opposite_rad = std::max(opposite_rad, extremes.opposite_rad);
    end_rad = std::max(end_rad, extremes.end_rad);
    speed_share = std::max(speed_share, extremes.speed_share);
  }
  std::printf("chain: nearest to the other limit %.4f rad inside, at the end %.4f; fastest %.3f of the fault\n",
              -opposite_rad, -end_rad, speed_share);
  EXPECT_LE(opposite_rad, 0);
  EXPECT_LE(end_rad, guard::Recovery::kAtLimitRad);
}

// What robot files declare holds for what they simulate, with 5 % error of the drive's torque.
TEST(LimitsDeclared, CoverWhatTheRobotFilesSimulate) {
  for (const char* name : {"arm", "arm8", "arm32", "frankenstein", "quadruped"}) {
    const robot::RobotConfig robot = load(name);
    EXPECT_TRUE(robot.notes.empty()) << robot.notes.front();
    for (const robot::JointConfig& joint : robot.joints) {
      EXPECT_GE(joint.load_max_nm, joint.sim.mgl_nm + joint.sim.cogging_nm +
                                       9.81 * joint.sim.payload_kg * joint.sim.payload_m +
                                       joint.sim.torque_gain_error * joint.torque_max_nm)
          << name << " " << joint.name;
      EXPECT_GE(joint.inertia_max_kg_m2,
                joint.sim.inertia_kg_m2 + joint.sim.payload_kg * joint.sim.payload_m * joint.sim.payload_m)
          << name << " " << joint.name;
      EXPECT_LE(joint.inertia_min_kg_m2, joint.sim.inertia_kg_m2) << name << " " << joint.name;
    }
  }
}

}  // namespace
}  // namespace lithe::limits
