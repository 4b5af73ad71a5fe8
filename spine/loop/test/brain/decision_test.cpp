// SPDX-License-Identifier: Apache-2.0
// Every plan that a tick has seen has an answer by its id, whatever became of it.
#include <gtest/gtest.h>

#include <limits>
#include <map>
#include <string>
#include <vector>

#include "spine/loop/test/tick_rig.hpp"

namespace lithe::loop {
namespace {

using wire::PlanReject;

class DecisionTest : public TickTest {
 protected:
  // The plan is published, and a tick looks.
  std::uint64_t decide(wire::Plan plan) {
    plan.plan_id = ++plan_id_;
    ipc::ChannelWriter<wire::Plan>(brain_memory_->plan).write(plan);
    brain_memory_->header.heartbeat_ns = now_ns_;
    tick();
    for (wire::PlanDecision each; decisions_.next(each);) answers_.emplace(each.plan_id, each);
    return plan.plan_id;
  }
  wire::Plan plan_to(double goal_rad, std::int64_t in_ms = 2000) const {
    wire::Plan plan;
    plan.waypoint_count = plan.joint_count = 1;
    plan.t_ns[0] = now_ns_ + in_ms * kNsPerMs;
    plan.position_rad[0] = goal_rad;
    plan.velocity_rad_s.fill(std::numeric_limits<double>::quiet_NaN());
    return plan;
  }
  const wire::PlanDecision& answer(std::uint64_t id) const { return answers_.at(id); }
  PlanReject reason(std::uint64_t id) const { return static_cast<PlanReject>(answer(id).reject); }
  std::string words(const wire::Plan& plan) { return answer(decide(plan)).text.data(); }

  ipc::RingReader<wire::PlanDecision, wire::spine_segment::kPlanDecisionsDepth> decisions_{memory_->plan_decisions};
  std::map<std::uint64_t, wire::PlanDecision> answers_;
};

TEST_F(DecisionTest, EveryPlanHasItsOwnAnswerInWhateverModeAndHoweverManyAreRefused) {
  const std::uint64_t before = decide(plan_to(0.1));
  arm_with(kPd);
  std::vector<std::uint64_t> good, bad;
  for (int i = 0; i < 500; ++i) {
    bad.push_back(decide(plan_to(9.0)));
    good.push_back(decide(plan_to(0.1)));
    bad.push_back(decide(plan_to(0.1, -1)));
  }
  ASSERT_EQ(send(CommandKind::hold), CommandResult::done);
  const std::uint64_t held = decide(plan_to(0.2));

  EXPECT_EQ(answers_.size(), 1502U);
  EXPECT_EQ(reason(before), PlanReject::mode);
  EXPECT_EQ(static_cast<Mode>(answer(before).value), Mode::disarmed);
  for (const std::uint64_t id : good) ASSERT_EQ(reason(id), PlanReject::none) << id;
  for (const std::uint64_t id : bad) ASSERT_NE(reason(id), PlanReject::none) << id;
  EXPECT_EQ(reason(held), PlanReject::mode);
  EXPECT_EQ(static_cast<Mode>(answer(held).value), Mode::hold);
  EXPECT_EQ(record_.plan_id, good.back());
  EXPECT_EQ(answer(held).t_ns, now_ns_ + 100) << "when it woke";
}

TEST_F(DecisionTest, ARefusalNamesWhatWhereAndTheLimit) {
  arm_with(kPd);
  wire::Plan plan = plan_to(9.0);
  EXPECT_EQ(words(plan), "position_limit at joint shoulder, waypoint 1: 9.000 rad, allowed -3.000 to 3.000");
  EXPECT_EQ(words(plan_to(0.1)), "") << "it is followed";
  plan = plan_to(0.1);
  plan.waypoint_count = 17;
  EXPECT_EQ(words(plan), "count: 17 waypoints, allowed 1 to 16");
  plan = plan_to(0.1);
  plan.joint_count = 2;
  EXPECT_EQ(words(plan), "joints: the plan has 2, the robot 1");
  plan = plan_to(std::numeric_limits<double>::quiet_NaN());
  EXPECT_EQ(words(plan), "not_finite at joint shoulder, waypoint 1");
  plan = plan_to(0.1);
  plan.waypoint_count = 2;
  plan.t_ns[1] = plan.t_ns[0] - 20 * kNsPerMs;
  EXPECT_EQ(words(plan), "time_order: waypoint 2 is 0.020 s before the one before it");
  plan.t_ns[0] = now_ns_ + period_ns_ - 12 * kNsPerS;
  plan.t_ns[1] = now_ns_ + kNsPerS;
  EXPECT_EQ(words(plan), "too_old: waypoint 1 is 12.000 s behind the Spine's clock, allowed 10.000");
  EXPECT_EQ(words(plan_to(0.1, 1 - 3600'000)),
            "too_old: waypoint 1 is 3600.000 s behind the Spine's clock, allowed 0.000");
  EXPECT_EQ(words(plan_to(0.1, 1 + 12'000)),
            "too_far: waypoint 1 is 12.000 s ahead of the Spine's clock, allowed 10.000");
  plan = plan_to(0.0, 1000);
  plan.waypoint_count = 2;
  plan.t_ns[1] = plan.t_ns[0] + 20 * kNsPerMs;
  plan.position_rad[wire::kNj] = -2.0;
  EXPECT_EQ(words(plan), "velocity_limit at joint shoulder, waypoint 2: 100.000 rad/s, allowed 30.000");
  plan.position_rad[wire::kNj] = 0.0;
  plan.velocity_rad_s[0] = -31;
  EXPECT_EQ(words(plan), "velocity_limit at joint shoulder, waypoint 1: 31.000 rad/s, allowed 30.000");
  EXPECT_EQ(answer(plan_id_).needs_s, 0.0) << "more time does not help";
}

}  // namespace
}  // namespace lithe::loop
