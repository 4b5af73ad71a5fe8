// SPDX-License-Identifier: Apache-2.0
// Many robots, laws and circumstances: no good law is taken away, and bad ones are.
#include <array>
#include <cstdio>
#include <random>
#include <string>

#include "spine/loop/test/watch/watch_rig.hpp"

namespace lithe::loop {
namespace {

struct Dice {
  explicit Dice(std::uint64_t seed) : random(seed) {}
  double between(double low, double high) { return std::uniform_real_distribution<double>(low, high)(random); }
  std::uint32_t below(std::size_t n) { return static_cast<std::uint32_t>(random() % n); }
  std::mt19937_64 random;
};

robot::RobotConfig a_robot(Dice& dice) {
  constexpr std::array kNames{"arm", "chain", "quadruped"};
  constexpr std::array kRates{500.0, 1000.0, 2000.0};
  auto robot = robot::load_robot(std::string(LITHE_ROBOTS) + "/" + kNames[dice.below(3)] + ".toml");
  EXPECT_TRUE(robot) << robot.message();
  robot->rate_hz = kRates[dice.below(3)];
  for (robot::JointConfig& joint : robot->joints) {
    joint.sim.mgl_nm *= dice.between(0.3, 1.2);
    joint.sim.coulomb_nm *= dice.between(0, 2);
    joint.sim.seed = dice.random();
  }
  return *robot;
}

// A robot that follows its plan under a confirmed law; null: that law was not confirmed.
std::unique_ptr<WatchBench> a_bench(const robot::RobotConfig& robot, Dice& dice) {
  auto bench = std::make_unique<WatchBench>(robot);
  const double kp = dice.between(3, 6), kd = dice.between(0.1, 0.16);
  const bool knows_weight = robot.joints.size() == 1 && dice.below(2) == 0;
  for (std::size_t j = 0; j < robot.joints.size(); ++j) {
    const robot::JointConfig& joint = robot.joints[j];
    WatchBench::gains(j, kp, kd, joint.torque_max_nm, knows_weight ? joint.sim.mgl_nm : 0);
  }
  bench->hz = dice.between(0.1, 0.5);
  bench->amplitude_rad = dice.between(0.1, 0.4);
  bench->begin();
  bench->follow(2);
  if (!bench->confirmed() || bench->mode() != Mode::active) bench.reset();
  return bench;
}

struct Tally {
  int runs = 0, taken = 0, alarms = 0, stopped_by_guard = 0, named = 0;
};

// What changes outside a good law, one to three at once.
void change(WatchBench& bench, const robot::RobotConfig& robot, Dice& dice) {
  const std::uint32_t joint = dice.below(robot.joints.size());
  const robot::JointConfig& of = robot.joints[joint];
  const double load_nm = dice.between(-0.8, 0.8) * of.load_max_nm, at_rad = dice.between(-0.3, 0.3);
  const bool wall = dice.below(3) == 0, loaded = dice.below(2) == 0;
  bench.outside.load_nm = [=](std::uint32_t j, double position_rad, double velocity_rad_s) {
    if (j != joint) return 0.0;
    const double into_rad = at_rad - position_rad;
    const double push_nm = std::min(10 * into_rad - 0.1 * std::min(velocity_rad_s, 0.0), of.torque_max_nm);
    return (loaded ? load_nm : 0) + (wall && into_rad > 0 ? push_nm : 0);
  };
  if (dice.below(2) == 0) bench.hz *= dice.between(1, 3);
  if (dice.below(2) == 0) bench.amplitude_rad *= dice.between(1, 1.5);
  if (dice.below(3) == 0) bench.outside.share = dice.between(0.5, 1);
}

Tally good_laws(int runs) {
  Tally tally;
  for (int i = 0; i < runs; ++i) {
    Dice dice(static_cast<std::uint64_t>(i) + 1);
    const robot::RobotConfig robot = a_robot(dice);
    const auto bench = a_bench(robot, dice);
    if (bench == nullptr) continue;
    change(*bench, robot, dice);
    bench->follow_until_taken(6);
    bench->outside = {};
    bench->follow_until_taken(3);
    ++tally.runs;
    tally.alarms += bench->count(EventKind::law_suspected) > 0 ? 1 : 0;
    tally.stopped_by_guard += bench->mode() == Mode::active ? 0 : 1;
    if (bench->count(EventKind::law_faulted) == 0) continue;
    ++tally.taken;
    std::printf("run %d: %s, %s\n", i, robot.name.c_str(), bench->text(EventKind::law_faulted).c_str());
  }
  return tally;
}

Tally bad_laws(int runs, Turn turn) {
  Tally tally;
  for (int i = 0; i < runs; ++i) {
    Dice dice(static_cast<std::uint64_t>(i) + 1'000'001);
    const robot::RobotConfig robot = a_robot(dice);
    const auto bench = a_bench(robot, dice);
    if (bench == nullptr) continue;
    Watched::of = dice.below(robot.joints.size());
    Watched::turn = turn;
    bench->amplitude_rad = 0.4;
    bench->follow_until_taken(10);
    ++tally.runs;
    const std::string why = bench->text(EventKind::law_faulted);
    tally.taken += why.empty() ? 0 : 1;
    tally.stopped_by_guard += why.empty() && bench->mode() != Mode::active ? 1 : 0;
    tally.named += why.find("joint " + robot.joints[Watched::of].name + ",") != std::string::npos ||
                           why.find("joint " + robot.joints[Watched::of].name + " ") != std::string::npos
                       ? 1
                       : 0;
  }
  return tally;
}

void good_and_bad(int runs) {
  const Tally good = good_laws(runs);
  std::printf("good laws: %d runs, %d taken away, %d with an alarm, %d stopped by the guard\n", good.runs, good.taken,
              good.alarms, good.stopped_by_guard);
  EXPECT_GT(good.runs, runs / 2);
  EXPECT_EQ(good.taken, 0);
  for (const Turn turn : {Turn::reversed, Turn::silent, Turn::undamped, Turn::hammers, Turn::chatters}) {
    const Tally bad = bad_laws(runs, turn);
    std::printf("%s: %d runs, %d taken away, %d stopped by the guard, %d name the joint\n", name_of(turn), bad.runs,
                bad.taken, bad.stopped_by_guard, bad.named);
    EXPECT_GT(bad.named, bad.taken / 2) << name_of(turn);  // a neighbour may shake more
    if (turn == Turn::reversed) EXPECT_EQ(bad.taken + bad.stopped_by_guard, bad.runs);
    // A joint of little weight hardly moves without torque, and friction may damp what the law does not.
    EXPECT_GT(bad.taken, turn == Turn::undamped ? 0 : bad.runs / 2) << name_of(turn);
  }
}

TEST(WatchManyTest, NoGoodLawIsTakenAwayAndBadOnesAre) { good_and_bad(6); }
TEST(WatchManyTest, DISABLED_Many) { good_and_bad(200); }

}  // namespace
}  // namespace lithe::loop
