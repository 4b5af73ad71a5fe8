// SPDX-License-Identifier: Apache-2.0
#include "supervisor/cli/robot/motion.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <memory>
#include <string>

namespace lithe::cli {
namespace {

using control::Refusal;

constexpr std::int64_t kNowNs = 5'000'000'000;
constexpr double kRad = 3.14159265358979323846 / 180;

class MotionTest : public ::testing::Test {
 protected:
  void SetUp() override {
    info_->joint_count = now_->joint_count = 2;
    std::strcpy(info_->joint_name.data(), "shoulder");
    std::strcpy(info_->joint_name.data() + 32, "elbow");
    for (int j = 0; j < 2; ++j) {
      info_->position_min_rad[j] = -90 * kRad;
      info_->position_max_rad[j] = 90 * kRad;
      info_->velocity_max_rad_s[j] = 60 * kRad;
      now_->setpoint_position_rad[j] = (10 + j) * kRad;
    }
    now_->mode = static_cast<std::uint32_t>(wire::Mode::active);
  }
  std::variant<Move, Refusal> plan(const Motion& motion) { return plan_motion(motion, *info_, *now_, kNowNs); }
  std::string refused(const Motion& motion, const std::string& code) {
    const auto planned = plan(motion);
    const auto* refusal = std::get_if<Refusal>(&planned);
    if (refusal == nullptr) return "not refused";
    EXPECT_EQ(refusal->code, code);
    return refusal->message + "; " + refusal->next;
  }

  std::unique_ptr<wire::RobotInfo> info_ = std::make_unique<wire::RobotInfo>();
  std::unique_ptr<wire::Telemetry> now_ = std::make_unique<wire::Telemetry>();
};

TEST_F(MotionTest, OneJointGoesAndTheOthersStayWhereTheirSetpointsAre) {
  const auto planned = plan({"elbow", 41, false, 2.0});
  ASSERT_TRUE(std::holds_alternative<Move>(planned));
  const wire::Plan& plan = std::get<Move>(planned).plan;
  EXPECT_EQ(plan.waypoint_count, 1u);
  EXPECT_EQ(plan.streaming, 0u);
  EXPECT_EQ(plan.t_ns[0], kNowNs + 2'000'000'000);
  EXPECT_DOUBLE_EQ(plan.position_rad[0], 10 * kRad);
  EXPECT_DOUBLE_EQ(plan.position_rad[1], 41 * kRad);
  EXPECT_TRUE(std::isnan(plan.velocity_rad_s[1])) << "the Spine chooses";
}

TEST_F(MotionTest, JogCountsFromTheSetpoint) {
  const auto planned = plan({"elbow", -5, true, 2.0});
  ASSERT_TRUE(std::holds_alternative<Move>(planned));
  EXPECT_NEAR(std::get<Move>(planned).to_rad, 6 * kRad, 1e-12);
}

TEST_F(MotionTest, AJointThatStandsStillHasNotArrivedAndOneWithItsOldErrorHas) {
  Move move;
  move.joint = 1;
  move.to_rad = 1;
  EXPECT_TRUE(has_arrived(move, 1));
  EXPECT_TRUE(has_arrived(move, 0.91)) << "within a tenth of the way";
  EXPECT_FALSE(has_arrived(move, 0.89));
  EXPECT_FALSE(has_arrived(move, 1.11));
  EXPECT_FALSE(has_arrived(move, std::nan("")));
  move.at_rad = -0.2;  // the law sags
  EXPECT_TRUE(has_arrived(move, 0.8)) << "it went the whole way, and sags as before";
  EXPECT_FALSE(has_arrived(move, 0.6));
  move.from_rad = 60 * kRad;
  move.to_rad = 61 * kRad;
  move.at_rad = 30 * kRad;  // against a stop
  EXPECT_FALSE(has_arrived(move, 28.9 * kRad));
  move.to_rad = 30 * kRad;
  EXPECT_TRUE(has_arrived(move, 30 * kRad)) << "the setpoint came to the joint";
  move.to_rad = 64 * kRad;
  ASSERT_FALSE(has_arrived(move, 30 * kRad));
  now_->position_rad[1] = 30 * kRad;
  now_->command_torque_nm[1] = 1.96;
  info_->torque_max_nm[1] = 2;
  const Refusal why = not_arrived(move, *info_, *now_);
  EXPECT_EQ(why.code, "not_arrived");
  for (const char* part : {"elbow", "at 30.00 deg", "target is 64.00 deg", "1.960 N m of 2 N m"})
    EXPECT_NE(why.message.find(part), std::string::npos) << why.message;
  EXPECT_NE(why.next.find("at the limit"), std::string::npos);
}

TEST_F(MotionTest, WhatCannotBeIsRefusedWithJointValueAndLimit) {
  const std::string range = refused({"elbow", 91, false, 5.0}, "refused_range");
  EXPECT_NE(range.find("elbow to 91.00 deg: its limits are -90.00 to 90.00 deg"), std::string::npos) << range;
  const std::string fast = refused({"elbow", 71, false, 1.0}, "refused_range");
  EXPECT_NE(fast.find("needs 90.0 deg/s on the way: its limit is 60.0 deg/s; more time: --in 1.6s"), std::string::npos)
      << fast;
  EXPECT_TRUE(std::holds_alternative<Move>(plan({"elbow", 71, false, 1.6})));
  EXPECT_NE(refused({"elbwo", 1, false, 2.0}, "unknown_joint").find("did you mean 'elbow'?"), std::string::npos);
  EXPECT_NE(refused({"elbow", 1, false, 11.0}, "usage").find("0.1 to 10 s"), std::string::npos);
  EXPECT_NE(refused({"elbow", NAN, false, 2.0}, "refused_range").find("limits"), std::string::npos);
  now_->mode = static_cast<std::uint32_t>(wire::Mode::disarmed);
  EXPECT_NE(refused({"elbow", 1, false, 2.0}, "refused_mode").find("disarmed"), std::string::npos);
  now_->mode = static_cast<std::uint32_t>(wire::Mode::estop);
  EXPECT_NE(refused({"elbow", 1, false, 2.0}, "refused_mode").find("lithe reset"), std::string::npos);
}

}  // namespace
}  // namespace lithe::cli
