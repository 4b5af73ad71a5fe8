// SPDX-License-Identifier: Apache-2.0
// What a law on probation is not blamed for: late buses, the soft start, plans near a limit, its own first tick.
#include <cmath>
#include <string>

#include "spine/loop/test/laws_rig.hpp"

namespace lithe::loop {
namespace {

class BlameTest : public LawsTest {
 protected:
  void on_probation() { terms_.probation_ticks = 1000, terms_.probation_error_ratio = 3; }
  // Swaps it in while the robot is disarmed, then arms.
  void stage_at_rest(const LitheLaw& law) {
    ASSERT_EQ(send(CommandKind::disarm), CommandResult::done);
    ticks(500);
    on_probation();
    stage(law);
    ticks(3);
    ASSERT_EQ(send(CommandKind::arm), CommandResult::done);
  }
  double off_rad() const { return std::abs(record_.setpoint_position_rad[0] - record_.position_rad[0]); }
};

// Follows its setpoint exactly: inertia and weight of the rig's joint are known.
struct Follows {
  struct Params {};
  struct State {};
  static void step(const Tick& t, const Params&, State&, Effort& u) {
    const double error_rad =
        t.setpoint_position_rad[0] - t.sample_age_s * t.setpoint_velocity_rad_s[0] - t.position_rad[0];
    u.torque_nm[0] = 2.5e-3 * t.setpoint_acceleration_rad_s2[0] + 0.165 * std::sin(t.position_rad[0]) + 4 * error_rad +
                     0.1 * (t.setpoint_velocity_rad_s[0] - t.velocity_rad_s[0]);
  }
};
constexpr LitheLaw kFollows = describe<Follows>("follows");

class LateBus : public BlameTest, public testing::WithParamInterface<int> {};

TEST_P(LateBus, IsNotBlamedOnTheLaw) {
  robot_.spine.late_ticks_to_stop = 20;
  use_cell(nullptr);
  arm_with(kFollows);
  ticks(1500);
  on_probation();
  terms_.probation_error_ratio = 2;
  stage(kFollows);
  ticks(2);
  publish(2.8, 300);
  live(146);  // 17.5 rad/s
  ASSERT_EQ(slot_.active()->law_id, 2u);
  for (int i = 0; i < GetParam(); ++i) tick(false);
  EXPECT_GT(off_rad(), 2 * step::Probation::kLeastErrorRad) << "else this shows nothing";
  serve();
  live(300);
  EXPECT_EQ(mode(), Mode::active);
  EXPECT_EQ(slot_.active()->law_id, 2u);
}
// 9 ms old: the age of the sample explains the error. 17 ms: the joint went on without the law, as in a pause.
INSTANTIATE_TEST_SUITE_P(Ticks, LateBus, testing::Values(8, 17));

TEST_F(BlameTest, TheSoftStartIsNotBlamedOnTheLaw) {
  robot_.guard.soft_start_s = 2;
  use_cell(nullptr);
  arm_with(kPd);
  ticks(3000);
  stage_at_rest(kPd);
  publish(1.5, 500);
  double most_rad = 0;
  for (int i = 0; i < 2500; ++i) {
    live(1);
    most_rad = std::max(most_rad, off_rad());
  }
  EXPECT_GT(most_rad, 3 * step::Probation::kLeastErrorRad) << "else this shows nothing";
  EXPECT_EQ(slot_.active()->law_id, 2u);
  EXPECT_EQ(events(EventKind::law_rolled_back).size(), 0u);
}

TEST_F(BlameTest, ABadLawIsFoundAfterTheSoftStart) {
  robot_.guard.soft_start_s = 0.5;
  use_cell(nullptr);
  arm_with(kPd);
  ticks(1000);
  stage_at_rest(kLazy);
  publish(1.0, 300);
  live(500 + 301);
  EXPECT_EQ(slot_.active()->law_id, 1u);
}

TEST_F(BlameTest, ALawThatTheSoftStartDoesNotLimitIsJudgedInIt) {
  robot_.guard.soft_start_s = 2;
  use_cell(nullptr);
  arm_with(kPd);
  ticks(3000);
  Beside<1>::off_rad = 0.25;
  stage_at_rest(kFirst);
  ticks(1900);
  EXPECT_NE(record_.flags & flag::kSoftStarting, 0u);
  EXPECT_EQ(slot_.active()->law_id, 1u);
}

// 0.05 rad before the limit: in the guard's soft stop, where every outward torque is reduced.
TEST_F(BlameTest, APlanThatEndsNearALimitIsNotBlamedOnTheLaw) {
  arm_with(kPd);
  ticks(1500);
  terms_.probation_ticks = 5000, terms_.probation_error_ratio = 100;
  stage(kPd);
  ticks(2);
  publish(2.95, 1000);
  live(2500);
  ASSERT_NE(record_.flags & flag::kPositionClamped, 0u) << "else this shows nothing";
  EXPECT_EQ(slot_.active()->law_id, 2u);
}

// The derivative of an error that is not known in the first tick.
struct Kicks {
  struct Params {};
  struct State {
    double first = 1;
  };
  static void step(const Tick& t, const Params&, State& s, Effort& u) {
    u.torque_nm[0] = 4 * (t.setpoint_position_rad[0] - t.position_rad[0]) - 0.1 * t.velocity_rad_s[0] + 20 * s.first;
    s.first = 0;
  }
};
constexpr LitheLaw kKicks = describe<Kicks>("kicks");

TEST_F(BlameTest, AKickInALawsFirstTickIsNotBlendedOut) {
  arm_with(kPd);
  ticks(1500);
  terms_.blend_ticks = 200;
  on_probation();
  stage(kKicks);
  double most_rad = 0;
  for (int i = 0; i < 300; ++i) {
    tick();
    most_rad = std::max(most_rad, off_rad());
  }
  EXPECT_LT(most_rad, 0.02);
  EXPECT_EQ(slot_.active()->law_id, 2u);
}

// Swings the joint with torques that are finite only without the product of its gains.
struct Overflows {
  struct Params {};
  struct State {};
  static void step(const Tick&, const Params&, State&, Effort& u) {
    u.kd_nm_s_rad[0] = 1e308;
    u.velocity_rad_s[0] = 1e3;
  }
};
constexpr LitheLaw kOverflows = describe<Overflows>("overflows");

TEST_F(BlameTest, ATorqueThatNoNumberHoldsIsALawFault) {
  arm_with(kPd);
  stage(kOverflows);
  ticks(3);
  EXPECT_EQ(slot_.active()->law_id, 1u);
  ASSERT_EQ(events(EventKind::law_rolled_back).size(), 1u);
  EXPECT_EQ(std::string(events(EventKind::law_rolled_back)[0].text.data())
                .find("not_finite: joint shoulder, the torque of its gains; at "),
            0u);
}

}  // namespace
}  // namespace lithe::loop
