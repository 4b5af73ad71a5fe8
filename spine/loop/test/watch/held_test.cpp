// SPDX-License-Identifier: Apache-2.0
// Probation and watch while a policy steps the setpoint: a good law is not blamed for it, a bad one is still found.
#include <string>
#include <string_view>

#include "spine/loop/test/watch/watch_rig.hpp"
#include "spine/robot/robot.hpp"

namespace lithe::loop {
namespace {

struct Motion {
  const char* name;
  double hz, amplitude_rad;
  bool square;
};
constexpr std::array kMotions{Motion{"slow policy", 0.3, 0.3, false}, Motion{"fast policy", 1.0, 0.4, false},
                              Motion{"steps of half a radian", 0.4, 0.25, true}};

class HeldWatch : public testing::TestWithParam<const char*> {
 protected:
  void open() {
    auto robot = robot::load_robot(std::string(LITHE_ROBOTS) + "/" + GetParam() + ".toml");
    ASSERT_TRUE(robot) << robot.message();
    bench_ = std::make_unique<WatchBench>(*robot);
    for (std::size_t j = 0; j < robot->joints.size(); ++j)
      WatchBench::gains(j, 4.0, 0.1, robot->joints[j].torque_max_nm);
  }
  // The same motion as a curve, before the plans step; a square has none.
  void move_as(const Motion& motion) {
    if (motion.square) return;
    bench_->hz = motion.hz;
    bench_->amplitude_rad = motion.amplitude_rad;
  }
  void step_as(const Motion& motion) {
    bench_->held = true;
    bench_->hz = motion.hz;
    bench_->amplitude_rad = motion.amplitude_rad;
    bench_->square = motion.square;
  }
  void expect_unblamed(const std::string& when) {
    EXPECT_TRUE(bench_->confirmed()) << when << ": " << bench_->text(EventKind::law_rolled_back);
    EXPECT_EQ(bench_->mode(), Mode::active) << when << ": " << bench_->text(EventKind::safe_stop);
  }
  std::unique_ptr<WatchBench> bench_;
};

TEST_P(HeldWatch, AGoodLawIsNotBlamedWhenPlansBeginToStepAndWhenTheyEnd) {
  for (const Motion& motion : kMotions) {
    open();
    move_as(motion);
    bench_->begin();
    step_as(motion);
    bench_->follow(6);
    expect_unblamed(motion.name);
    bench_->held = bench_->square = false;
    bench_->follow(3);
    expect_unblamed(std::string("a curve after ") + motion.name);
  }
}

TEST_P(HeldWatch, AGoodLawIsConfirmedWhenPlansBeginToStepOnProbation) {
  for (const Motion& motion : kMotions) {
    open();
    move_as(motion);
    bench_->with_second = false;
    bench_->begin();
    bench_->stage_second();
    step_as(motion);
    bench_->follow(4);
    expect_unblamed(motion.name);
  }
}

TEST_P(HeldWatch, ALawThatDoesNotFollowStepsIsTakenBackOnProbation) {
  open();
  bench_->with_second = false;
  bench_->begin();
  bench_->stage_second();
  Watched::turn = Turn::silent;
  step_as(kMotions[2]);
  bench_->follow(0.05);
  ASSERT_EQ(bench_->runs(), 2u);
  bench_->follow_until_taken(4);
  EXPECT_TRUE(bench_->text(EventKind::law_rolled_back).starts_with("tracking_lost"))
      << bench_->text(EventKind::law_rolled_back);
}

TEST_P(HeldWatch, ALawThatTurnsBadUnderAPolicyIsFound) {
  for (const Turn turn : {Turn::reversed, Turn::hammers, Turn::chatters}) {
    // There the guard's slew bound finds it, which does not count under a policy.
    if (turn == Turn::hammers && std::string_view(GetParam()) == "arm") continue;
    open();
    bench_->begin();
    step_as(kMotions[0]);
    bench_->follow(3);
    Watched::turn = turn;
    bench_->follow_until_taken(10);
    EXPECT_TRUE(bench_->taken()) << name_of(turn);
  }
}

INSTANTIATE_TEST_SUITE_P(Robots, HeldWatch, testing::Values("arm", "chain", "frankenstein", "quadruped"),
                         [](const auto& robot) { return std::string(robot.param); });

}  // namespace
}  // namespace lithe::loop
