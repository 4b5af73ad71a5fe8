// SPDX-License-Identifier: Apache-2.0
// A law that was confirmed and turns bad later, and what is not its fault.
#include <algorithm>
#include <cmath>
#include <string>

#include "spine/loop/test/recover_rig.hpp"
#include "spine/loop/test/watch/watch_rig.hpp"

namespace lithe::loop {
namespace {

using robot::WatchAction;

// Four bad windows in a row, the one in which it began, and the time in which the joints leave their setpoints.
constexpr double kSoonS = (step::Watch::kActScore + 1) * step::Watch::kWindowS + 0.75;

class OneWatchTest : public testing::Test {
 protected:
  void open(const std::string& name, WatchAction action, double error_ratio, bool with_second) {
    auto robot = robot::load_robot(std::string(LITHE_ROBOTS) + "/" + name + ".toml");
    ASSERT_TRUE(robot) << robot.message();
    robot_ = *robot;
    robot_.swap.watch = action;
    for (robot::JointConfig& joint : robot_.joints) {
      joint.position_min_rad = std::max(joint.position_min_rad, -widest_rad_);
      joint.position_max_rad = std::min(joint.position_max_rad, widest_rad_);
    }
    bench_ = std::make_unique<WatchBench>(robot_);
    bench_->error_ratio = error_ratio;
    bench_->with_second = with_second;
    for (std::size_t j = 0; j < robot_.joints.size(); ++j)
      WatchBench::gains(j, 4.0, 0.1, robot_.joints[j].torque_max_nm);
    bench_->begin();
    ASSERT_EQ(bench_->runs(), with_second ? 2u : 1u) << bench_->text(EventKind::law_rolled_back);
    ASSERT_TRUE(!with_second || bench_->confirmed());
    bench_->follow(2);
    ASSERT_EQ(bench_->count(EventKind::law_suspected), 0);
  }
  std::uint32_t last() const { return static_cast<std::uint32_t>(robot_.joints.size()) - 1; }
  std::uint32_t strongest() const {
    const auto weaker = [](const auto& a, const auto& b) { return a.torque_max_nm < b.torque_max_nm; };
    return static_cast<std::uint32_t>(std::ranges::max_element(robot_.joints, weaker) - robot_.joints.begin());
  }
  std::string name(std::uint32_t j) const { return robot_.joints[j].name; }
  // "kind: joint name, ..." is the reason of the rollback.
  void expect_taken(const std::string& reason) {
    EXPECT_EQ(bench_->runs(), 1u);
    EXPECT_EQ(bench_->count(EventKind::law_rolled_back), 1);
    EXPECT_EQ(bench_->count(EventKind::law_faulted), 1);
    EXPECT_TRUE(bench_->text(EventKind::law_rolled_back).starts_with(reason))
        << bench_->text(EventKind::law_rolled_back);
    EXPECT_EQ(bench_->count(EventKind::law_suspected), 1) << "the alarm comes first";
  }

  double widest_rad_ = 100;  // limits of position
  robot::RobotConfig robot_;
  std::unique_ptr<WatchBench> bench_;
};

class WatchTest : public OneWatchTest, public testing::WithParamInterface<const char*> {
 protected:
  void open(WatchAction action = WatchAction::last_good, double error_ratio = 3, bool with_second = true) {
    OneWatchTest::open(GetParam(), action, error_ratio, with_second);
  }
};

TEST_P(WatchTest, ALawThatReversesItsTorqueIsTakenAwayAndTheOneBeforeHoldsTheJointsWhereTheyAre) {
  open();
  Watched::turn = Turn::reversed;
  EXPECT_LT(bench_->follow_until_taken(8), kSoonS);
  expect_taken("pushes_away: joint ");
  EXPECT_EQ(bench_->mode(), Mode::hold);
  const wire::Telemetry then = bench_->record();
  bench_->follow(0.5);  // the speed that they had is gone
  for (std::uint32_t j = 0; j < robot_.joints.size(); ++j) {
    EXPECT_EQ(bench_->record().setpoint_position_rad[j], then.setpoint_position_rad[j]) << name(j);
    EXPECT_LT(std::abs(bench_->error_rad(j)), 0.5) << name(j) << " hangs by its weight";
  }
  EXPECT_EQ(bench_->send(CommandKind::arm), CommandResult::done);
  bench_->follow(4);
  EXPECT_EQ(bench_->mode(), Mode::active);
  EXPECT_EQ(bench_->runs(), 1u);
  EXPECT_LT(std::abs(bench_->error_rad(0)), 0.15) << "it follows its plan again";
}

TEST_P(WatchTest, TheJointThatIsPushedAwayIsNamed) {
  open();
  Watched::of = last();
  Watched::turn = Turn::reversed;
  EXPECT_LT(bench_->follow_until_taken(8), kSoonS);
  expect_taken("pushes_away: joint " + name(last()) + ", error ");
}

// With a threshold that nothing reaches, the same law is not found: the test above can fail.
TEST_P(WatchTest, WithoutAThresholdItIsNotTakenAway) {
  open(WatchAction::last_good, 1e9);
  Watched::turn = Turn::reversed;
  bench_->follow_until_taken(8);
  EXPECT_EQ(bench_->text(EventKind::law_rolled_back).find("pushes_away"), std::string::npos);
  EXPECT_TRUE(bench_->runs() == 2 || bench_->text(EventKind::law_rolled_back).starts_with("oscillating"))
      << "joints that bounce off their limits shake";
}

TEST_P(WatchTest, ALawThatGivesNoTorqueIsTakenAway) {
  open();
  bench_->amplitude_rad = 0.45;
  bench_->follow(4);
  Watched::turn = Turn::silent;
  bench_->follow_until_taken(20);
  expect_taken("gives_no_torque: joint ");
}

TEST_P(WatchTest, ALawThatBeginsToShakeIsTakenAway) {
  // The guard lets a light joint swing from limit to limit: near ones, so that each swing ends within a quarter of a
  // second. What swings more slowly is motion (law::Tremor).
  widest_rad_ = 1.0;
  for (const Turn turn : {Turn::undamped, Turn::hammers, Turn::chatters}) {
    open();
    Watched::of = last();
    Watched::turn = turn;
    EXPECT_LT(bench_->follow_until_taken(10), 8) << static_cast<int>(turn);
    const std::string why = bench_->text(EventKind::law_rolled_back) + bench_->text(EventKind::safe_stop);
    EXPECT_NE(why.find("joint "), std::string::npos) << why;  // a neighbour may shake more
    EXPECT_TRUE(bench_->taken());
  }
}

TEST_P(WatchTest, ItStopsTheRobotWhereTheFileSaysSo) {
  open(WatchAction::stop);
  Watched::turn = Turn::reversed;
  EXPECT_LT(bench_->follow_until_taken(8), kSoonS);
  EXPECT_EQ(bench_->mode(), Mode::safe_stop);
  EXPECT_EQ(bench_->runs(), 2u);
  EXPECT_TRUE(bench_->text(EventKind::safe_stop).starts_with("pushes_away: joint "));
  EXPECT_EQ(bench_->count(EventKind::law_marked), 1);
  ASSERT_EQ(bench_->send_off(CommandKind::reset), CommandResult::done);
  bench_->ticks(20);
  EXPECT_EQ(bench_->send(CommandKind::arm), CommandResult::refused_marked);
}

TEST_P(WatchTest, WithoutALawBeforeItTheRobotIsStopped) {
  open(WatchAction::last_good, 3, false);
  Proven::turn = Turn::reversed;
  EXPECT_LT(bench_->follow_until_taken(8), kSoonS);
  EXPECT_EQ(bench_->mode(), Mode::safe_stop);
  EXPECT_EQ(bench_->count(EventKind::law_marked), 1);
}

TEST_P(WatchTest, AnAlarmAloneIsToldOnceAndEndsWithItsCause) {
  open(WatchAction::alarm);
  Watched::turn = Turn::reversed;
  EXPECT_GE(bench_->follow_until_taken(5), 5);
  EXPECT_EQ(bench_->count(EventKind::law_suspected), 1);
  EXPECT_NE(bench_->record().flags & flag::kLawSuspected, 0u);
  Watched::turn = Turn::good;
  bench_->follow(8);
  EXPECT_EQ(bench_->record().flags & flag::kLawSuspected, 0u);
  EXPECT_EQ(bench_->count(EventKind::law_suspected), 1);
}

TEST_P(WatchTest, AFasterSetpointIsNotItsFault) {
  open();
  bench_->hz = 1.2;
  EXPECT_GE(bench_->follow_until_taken(6), 6);
  EXPECT_EQ(bench_->count(EventKind::law_suspected), 0) << bench_->text(EventKind::law_suspected);
}

// So much that the joint hangs half a radian beside its setpoint.
TEST_P(WatchTest, APayloadIsAnAlarmAndNotItsFault) {
  open();
  const double load_nm = std::min(2.0, 0.9 * robot_.joints[last()].torque_max_nm);
  bench_->outside.load_nm = [&](std::uint32_t j, double, double) { return j == last() ? -load_nm : 0; };
  EXPECT_GE(bench_->follow_until_taken(8), 8);
  EXPECT_EQ(bench_->runs(), 2u);
}

// A wall comes in the way of the strongest joint and stays for long; then it is taken away.
TEST_P(WatchTest, AnObstacleIsAnAlarmAndNotItsFault) {
  open();
  // The simulated wall is a tick late: a stiff one would shake the light arm.
  const double stiffness_nm_rad = robot_.name == "arm" ? 6 : 12;
  bool wall = true;
  double wall_rad = bench_->middle_rad(strongest()) - 0.4;
  bench_->outside.load_nm = [&](std::uint32_t j, double position_rad, double velocity_rad_s) {
    const double into_rad = wall_rad - position_rad;
    const double push_nm = stiffness_nm_rad * into_rad - 0.1 * std::min(velocity_rad_s, 0.0);
    return wall && j == strongest() && into_rad > 0 ? push_nm : 0;
  };
  bench_->hz = 0.05;
  for (int i = 0; i < 20; ++i) {
    wall_rad += 0.03;
    bench_->follow(0.1);
  }
  bench_->follow_until_taken(20);
  EXPECT_GE(bench_->count(EventKind::law_suspected), 1);
  EXPECT_TRUE(bench_->text(EventKind::law_suspected).starts_with("tracking_lost: joint " + name(strongest())));
  wall = false;
  bench_->follow(10);
  EXPECT_FALSE(bench_->taken()) << bench_->text(EventKind::law_rolled_back) << bench_->text(EventKind::safe_stop);
}

TEST_P(WatchTest, ADriveThatGivesLessTorqueIsNotItsFault) {
  open();
  bench_->outside.share = 0.3;
  EXPECT_GE(bench_->follow_until_taken(8), 8) << bench_->text(EventKind::law_rolled_back);
}

TEST_P(WatchTest, NewParametersHaveAReferenceOfTheirOwn) {
  open();
  wire::Command command;
  command.kind = static_cast<std::uint32_t>(CommandKind::set_params);
  command.count = 1;
  command.value[0] = 0.8;
  ASSERT_EQ(bench_->send(command), CommandResult::done);
  bench_->follow(4);
  ASSERT_EQ(bench_->count(EventKind::params_confirmed), 1);
  Watched::turn = Turn::reversed;
  EXPECT_LT(bench_->follow_until_taken(8), kSoonS);
  expect_taken("pushes_away: joint ");
}

// At 6.4 Hz the torque of the law brakes a joint that something else moves.
TEST_F(OneWatchTest, AJointThatIsShakenFromOutsideIsAnAlarmAndNotItsFault) {
  open("arm", WatchAction::last_good, 3, true);
  double phase = 0;
  bench_->outside.load_nm = [&](std::uint32_t, double, double) { return 0.6 * std::sin(phase += 0.04); };
  EXPECT_GE(bench_->follow_until_taken(8), 8) << bench_->text(EventKind::law_rolled_back);
  EXPECT_TRUE(bench_->text(EventKind::law_suspected).starts_with("oscillating: joint "))
      << bench_->text(EventKind::law_suspected);
}

TEST_F(OneWatchTest, OfTwelveJointsTheOneThatIsPushedAwayIsNamed) {
  open("quadruped", WatchAction::last_good, 3, true);
  Watched::of = 7;
  Watched::turn = Turn::reversed;
  EXPECT_LT(bench_->follow_until_taken(8), kSoonS);
  expect_taken("pushes_away: joint " + name(7) + ", error ");
}

// The drive closes the loop: the law gives targets, and turns them to the other side.
TEST_F(OneWatchTest, ATargetThatLeadsAwayIsFoundWhereTheDriveClosesItsOwnLoop) {
  for (const auto mode : {hal::cia402::Mode::velocity, hal::cia402::Mode::position}) {
    robot_ = robot_of(1000, {{.drive = robot::DeviceKind::cia402}});
    constexpr double kRatio = 20;  // else a count is a step of 1.5 mrad
    robot_.devices[0].keys.cia402.mode = mode;
    robot_.devices[0].keys.cia402.rated_torque_nm /= kRatio;
    robot_.joints[0].ratio = kRatio;
    robot_.joints[0].velocity_max_rad_s = 4;
    bench_ = std::make_unique<WatchBench>(robot_);
    Proven::by_target = Watched::by_target = true;
    bench_->begin();
    ASSERT_TRUE(bench_->confirmed()) << bench_->text(EventKind::law_rolled_back);
    bench_->follow(2);
    Watched::turn = Turn::reversed;
    EXPECT_LT(bench_->follow_until_taken(8), 2 * kSoonS) << "it moves at 4 rad/s at most";
    expect_taken("pushes_away: joint ");
    EXPECT_EQ(bench_->mode(), Mode::hold);
  }
}

INSTANTIATE_TEST_SUITE_P(Robots, WatchTest, testing::Values("arm", "chain", "frankenstein"));

}  // namespace
}  // namespace lithe::loop
