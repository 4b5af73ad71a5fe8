// SPDX-License-Identifier: Apache-2.0
// Two devices with one id: they answer one command twice, and not the same.
#include <gtest/gtest.h>

#include "spine/hal/test/two_joints_rig.hpp"

namespace lithe::hal {
namespace {

class Twins : public TwoJoints {
 protected:
  explicit Twins(std::uint32_t divider = 1) : TwoJoints(divider) {}
  bool conflict(std::size_t joint = 1) const { return (state_.status[joint] & wire::joint_status::kConflict) != 0; }
};

TEST_F(Twins, TwoAnswersThatContradictEachOtherCountForNothingAndThreeTimesMakeAConflict) {
  cycle(Trick::none);
  cycle(Trick::contradict, 2);
  EXPECT_FALSE(fresh(1));
  EXPECT_FALSE(conflict());
  EXPECT_EQ(actuators_.counters().conflicting, 2U);
  cycle(Trick::none);
  EXPECT_TRUE(fresh(1));
  cycle(Trick::contradict, 3);
  EXPECT_TRUE(conflict());
  EXPECT_FALSE(conflict(0));
  cycle(Trick::none, 31);
  EXPECT_TRUE(conflict()) << "a moment in which one of them is silent tells nothing";
  cycle(Trick::none);
  EXPECT_FALSE(conflict());
}

// As on a real bus, where nobody waits any more when the first has answered.
TEST_F(Twins, ASecondAnswerThatComesAfterTheExchangeIsComparedAsWell) {
  cycle(Trick::contradict_later, 4);
  EXPECT_TRUE(conflict());
}

class SeldomAsked : public Twins, public testing::WithParamInterface<std::uint32_t> {
 protected:
  SeldomAsked() : Twins(GetParam()) {}
};

// The second one answers when the exchange is over, and the next ones are not about this joint.
TEST_P(SeldomAsked, AConflictIsFoundAfterThreeTurns) {
  const int turn = static_cast<int>(GetParam());
  cycle(Trick::none, 2 * turn);
  cycle(Trick::contradict_later, 5 * turn);
  EXPECT_TRUE(conflict());
  EXPECT_FALSE(conflict(0));
  EXPECT_TRUE(fresh(0));
  cycle(Trick::none, 40 * turn);
  EXPECT_FALSE(conflict());
  EXPECT_TRUE(fresh(1));
}
INSTANTIATE_TEST_SUITE_P(Dividers, SeldomAsked, testing::Values(1U, 2U, 4U, 7U));

}  // namespace
}  // namespace lithe::hal
