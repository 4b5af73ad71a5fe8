// SPDX-License-Identifier: Apache-2.0
// What happens when answers are missing, late, doubled, foreign or nonsense.
#include "spine/hal/bus_actuators.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <memory>
#include <random>
#include <utility>
#include <vector>

#include "spine/hal/bus/loop_bus.hpp"
#include "spine/hal/device/moteus_drive.hpp"
#include "spine/hal/sim/sim_moteus.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::hal {
namespace {

constexpr std::size_t kInPosition = 5;  // the last digit of the position in an answer

enum class Trick { none, drop, twice, stray, garble, hold_back, babble, contradict, contradict_later };

// Stands between a drive and the bus and does to the answers what cables and firmware do.
class BadCable final : public BusNode {
 public:
  explicit BadCable(const sim::SimMoteusParams& params) : drive_(params) {}

  void on_frame(const Frame& frame, std::int64_t now_ns, FrameQueue& answers) LITHE_RT override {
    drive_.on_frame(frame, now_ns, fresh_);
    while (const Frame* answer = fresh_.front()) {
      Frame copy = *answer;
      fresh_.pop();
      play(copy, answers);
    }
  }

  void on_time(std::int64_t, FrameQueue& answers) LITHE_RT override {
    if (speaks_again_) answers.push(late_);
    speaks_again_ = false;
  }

  Trick trick = Trick::none;
  Frame* keep = nullptr;  // the next answer is copied here
  const Frame* replay = nullptr;
  std::mt19937 random{1};
  sim::SimMoteus& drive() { return drive_; }

 private:
  void play(Frame& answer, FrameQueue& answers) LITHE_RT {
    if (keep != nullptr) *keep = answer;
    if (replay != nullptr) answers.push(*replay);
    if (held_) {  // what was held back comes first: the order of a bus is never changed
      answers.push(late_);
      held_ = false;
    }
    switch (trick) {
      case Trick::drop:
        return;
      case Trick::twice:
        answers.push(answer);
        break;
      case Trick::contradict_later:
        late_ = answer;
        late_.data[kInPosition] ^= 1;
        speaks_again_ = true;
        break;
      case Trick::contradict:
        answers.push(answer);
        answer.data[kInPosition] ^= 1;
        break;
      case Trick::stray:
        answer.id = 99U << 8;
        break;
      case Trick::garble:
        answer.data[0] = 0x7f;
        break;
      case Trick::hold_back:
        late_ = answer;
        held_ = true;
        return;
      case Trick::babble:
        for (int i = 0; i < 100; ++i) answers.push(answer);
        return;
      case Trick::none:
        break;
    }
    answers.push(answer);
  }

  sim::SimMoteus drive_;
  FrameQueue fresh_;
  Frame late_;
  bool held_ = false;
  bool speaks_again_ = false;
};

// Two joints on one bus; the second one has the bad cable.
class TwoJoints : public testing::Test {
 protected:
  TwoJoints() {
    auto bus = std::make_unique<LoopBus>();
    bus_ = bus.get();
    for (std::uint32_t id : {1U, 2U}) {
      sim::SimMoteusParams params;
      params.id = id;
      params.plant.initial_position_rad = 0.1 * id;
      cables_.push_back(std::make_unique<BadCable>(params));
      bus_->attach(*cables_.back());
    }
    actuators_.add_bus(std::move(bus), Addressing::moteus);
    for (std::uint32_t id : {1U, 2U}) {
      moteus::DriverParams params;
      params.id = id;
      actuators_.add_joint(0, id, std::make_unique<moteus::MoteusDrive>(params));
    }
    command_.joints = 2;
  }

  void cycle(Trick trick, int times = 1) {
    cables_[1]->trick = trick;
    for (int i = 0; i < times; ++i) {
      ++command_.tick;
      actuators_.cycle(command_, state_, now_ns_);
      now_ns_ += 1'000'000;
    }
  }
  bool fresh(std::size_t joint) const { return (state_.status[joint] & wire::joint_status::kFresh) != 0; }
  bool lost(std::size_t joint) const { return (state_.status[joint] & wire::joint_status::kLost) != 0; }

  LoopBus* bus_;
  std::vector<std::unique_ptr<BadCable>> cables_;
  BusActuators actuators_;
  ActuatorCommand command_;
  ActuatorState state_;
  std::int64_t now_ns_ = 1'000'000'000;
};

TEST_F(TwoJoints, AMissingAnswerIsCountedAndTheLastValuesStay) {
  cycle(Trick::none);
  const double position = state_.position_rad[1];
  EXPECT_NEAR(position, 0.2, 4e-4);
  cycle(Trick::drop);
  EXPECT_TRUE(fresh(0));
  EXPECT_FALSE(fresh(1));
  EXPECT_FALSE(lost(1));
  EXPECT_EQ(state_.position_rad[1], position);
  EXPECT_EQ(actuators_.counters().missed, 1U);
}

TEST_F(TwoJoints, ThreeMissesInARowMakeAJointLostAndOneAnswerFindsIt) {
  cycle(Trick::none);
  cycle(Trick::drop, 2);
  EXPECT_FALSE(lost(1));
  cycle(Trick::drop);
  EXPECT_TRUE(lost(1));
  EXPECT_FALSE(lost(0));
  cycle(Trick::drop, 100);
  EXPECT_TRUE(lost(1));
  EXPECT_EQ(actuators_.counters().missed, 103U);
  cycle(Trick::none);
  EXPECT_FALSE(lost(1));
  EXPECT_TRUE(fresh(1));
}

TEST_F(TwoJoints, TheLastValuesStayAlsoWhenTheCallerAlternatesBuffers) {
  cycle(Trick::none);
  state_ = ActuatorState{};
  cycle(Trick::drop);
  EXPECT_NEAR(state_.position_rad[1], 0.2, 4e-4);
}

TEST_F(TwoJoints, ALateAnswerIsNeverTakenForTheNextOne) {
  cycle(Trick::none);
  cycle(Trick::hold_back);
  EXPECT_FALSE(fresh(1));
  const double still = state_.position_rad[1];
  cables_[1]->drive().servo().plant().place(0.7);
  cycle(Trick::none);  // the old answer comes right before the new one
  EXPECT_EQ(actuators_.counters().late, 1U);
  EXPECT_EQ(actuators_.counters().duplicate, 0U);
  EXPECT_NE(state_.position_rad[1], still);
  EXPECT_NEAR(state_.position_rad[1], 0.7, 4e-4);
}

// However long it was stuck somewhere.
TEST_F(TwoJoints, NoReplayedAnswerIsTakenForANewOne) {
  cycle(Trick::none);
  Frame old;
  for (int age = 1; age <= 125; ++age) {
    cables_[1]->keep = &old;
    cycle(Trick::none);
    cables_[1]->keep = nullptr;
    cycle(Trick::none, age - 1);
    cables_[1]->replay = &old;  // before the answer of this exchange, which does not come
    const std::uint64_t late = actuators_.counters().late;
    cycle(Trick::drop);
    cables_[1]->replay = nullptr;
    ASSERT_FALSE(fresh(1)) << age;
    ASSERT_EQ(actuators_.counters().late, late + 1) << age;
  }
}

TEST_F(TwoJoints, WhatArrivesBetweenTwoExchangesIsLate) {
  cycle(Trick::none);
  Frame request;
  request.id = 0x8000 | 2;
  bus_->send(request);
  cycle(Trick::none);
  EXPECT_EQ(actuators_.counters().late, 1U);
  EXPECT_TRUE(fresh(1));
}

TEST_F(TwoJoints, ADoubledAnswerCountsOnce) {
  cycle(Trick::twice, 10);
  EXPECT_TRUE(fresh(1));
  EXPECT_EQ(actuators_.counters().duplicate, 10U);
  EXPECT_EQ(actuators_.counters().missed, 0U);
}

TEST_F(TwoJoints, TwoAnswersThatContradictEachOtherCountForNothingAndThreeTimesMakeAConflict) {
  cycle(Trick::none);
  cycle(Trick::contradict, 2);
  EXPECT_FALSE(fresh(1));
  EXPECT_EQ(state_.status[1] & wire::joint_status::kConflict, 0U);
  EXPECT_EQ(actuators_.counters().conflicting, 2U);
  cycle(Trick::none);
  EXPECT_TRUE(fresh(1));
  cycle(Trick::contradict, 3);
  EXPECT_NE(state_.status[1] & wire::joint_status::kConflict, 0U);
  EXPECT_EQ(state_.status[0] & wire::joint_status::kConflict, 0U);
  cycle(Trick::none);
  EXPECT_EQ(state_.status[1] & wire::joint_status::kConflict, 0U);
}

// As on a real bus, where nobody waits any more when the first has answered.
TEST_F(TwoJoints, ASecondAnswerThatComesAfterTheExchangeIsComparedAsWell) {
  cycle(Trick::contradict_later, 4);
  EXPECT_NE(state_.status[1] & wire::joint_status::kConflict, 0U);
}

TEST_F(TwoJoints, AForeignAnswerIsStrayAndTheJointMissed) {
  cycle(Trick::stray);
  EXPECT_EQ(actuators_.counters().stray, 1U);
  EXPECT_EQ(actuators_.counters().missed, 1U);
}

TEST_F(TwoJoints, AGarbledAnswerIsMalformedAndTheJointMissed) {
  cycle(Trick::garble);
  EXPECT_EQ(actuators_.counters().malformed, 1U);
  EXPECT_EQ(actuators_.counters().missed, 1U);
  EXPECT_EQ(state_.position_rad[1], 0.0);
  cycle(Trick::garble, 2);
  EXPECT_NE(state_.status[1] & wire::joint_status::kGarbled, 0U) << "lost, but not silent";
  cycle(Trick::none);
  EXPECT_EQ(state_.status[1] & wire::joint_status::kGarbled, 0U);
}

TEST_F(TwoJoints, ABabblingNodeKeepsNobodyBusyForEver) {
  cycle(Trick::none);
  const std::uint64_t before = bus_->statistics().received;
  cycle(Trick::babble);
  EXPECT_LE(bus_->statistics().received - before, 256U + 4 * 2 + 16) << "what it may bring in one exchange";
  cycle(Trick::babble, 20);
  EXPECT_TRUE(fresh(0));
  EXPECT_TRUE(fresh(1));
  EXPECT_GT(actuators_.counters().late, 1000U);
}

TEST_F(TwoJoints, AnUnsoundCommandDampsItsJointAndIsCounted) {
  command_.act(DriveAction::torque);
  command_.torque_nm[1] = std::nan("");
  cycle(Trick::none, 20);
  EXPECT_EQ(actuators_.counters().unsound, 20U);
  EXPECT_EQ((state_.status[0] >> 16) & 0xff, 10U);
  EXPECT_EQ((state_.status[1] >> 16) & 0xff, 12U);
}

TEST_F(TwoJoints, AnyMixOfTroubleLeavesTheStateFiniteAndTheCountsConsistent) {
  std::mt19937 random(9);
  command_.act(DriveAction::torque);
  std::uint64_t expected_missed = 0;
  for (int i = 0; i < 5000; ++i) {
    cycle(static_cast<Trick>(random() % 9));
    expected_missed += (fresh(0) ? 0U : 1U) + (fresh(1) ? 0U : 1U);
    for (int joint = 0; joint < 2; ++joint) {
      ASSERT_TRUE(std::isfinite(state_.position_rad[joint]));
      ASSERT_LT(std::abs(state_.position_rad[joint]), 10.0);
    }
  }
  EXPECT_EQ(actuators_.counters().missed, expected_missed);
}

}  // namespace
}  // namespace lithe::hal
