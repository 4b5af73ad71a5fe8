// SPDX-License-Identifier: Apache-2.0
#include "supervisor/core/sequence.hpp"

#include <gtest/gtest.h>

#include <string>
#include <vector>

namespace lithe::control {
namespace {

using Number = Sequence::Reply<int>;

const Refusal kLate{"timeout", "", ""};
const Refusal kGone{"stopping", "", ""};

class SequenceTest : public testing::Test {
 protected:
  // Waits for a number, then for `open_`, and tells what it found.
  Sequence two_steps() {
    const auto number = co_await Number(pending_, 100, kLate);
    if (const auto* no = std::get_if<Refusal>(&number)) {
      told_.push_back(no->code);
      co_return;
    }
    told_.push_back(std::to_string(std::get<int>(number)));
    const auto why_not = co_await Sequence::Until([this](std::int64_t) { return open_; }, 200, kLate);
    told_.push_back(why_not ? why_not->code : "open");
  }

  Number::Pending pending_ = std::make_shared<std::optional<Number::Outcome>>();
  bool open_ = false;
  std::vector<std::string> told_;
};

TEST_F(SequenceTest, RunsOnlyWhenItIsServedAndGoesOnWhereItWaits) {
  Sequence sequence = two_steps();
  *pending_ = 7;
  EXPECT_TRUE(told_.empty());
  sequence.serve(1);
  EXPECT_EQ(told_, std::vector<std::string>{"7"}) << "what is there already is not waited for";
  sequence.serve(2);
  EXPECT_FALSE(sequence.done());
  open_ = true;
  sequence.serve(3);
  EXPECT_EQ(told_.back(), "open");
  EXPECT_TRUE(sequence.done());
  EXPECT_EQ(sequence.now_ns(), 3);
  sequence.serve(4);
  EXPECT_EQ(told_.size(), 2U) << "once is enough";
}

TEST_F(SequenceTest, AnAnswerIsTakenAlsoInTheTurnOfTheDeadlineAndALateOneIsNot) {
  Sequence sequence = two_steps();
  sequence.serve(1);
  sequence.serve(100);
  EXPECT_TRUE(told_.empty());
  *pending_ = 7;
  sequence.serve(101);
  sequence.serve(201);
  EXPECT_EQ(told_, (std::vector<std::string>{"7", "timeout"}));
}

TEST_F(SequenceTest, ARefusalIsAnAnswer) {
  Sequence sequence = two_steps();
  *pending_ = Refusal{"compile_failed", "", ""};
  sequence.serve(1);
  EXPECT_EQ(told_, std::vector<std::string>{"compile_failed"});
  EXPECT_TRUE(sequence.done());
}

TEST_F(SequenceTest, AnAbortEndsThisWaitAndEveryLaterOneThatIsNotReadyAtOnce) {
  Sequence waits = two_steps();
  waits.serve(1);
  waits.abort(kGone, 2);
  EXPECT_EQ(told_, std::vector<std::string>{"stopping"});
  told_.clear();
  Sequence has_its_number = two_steps();
  *pending_ = 7;
  has_its_number.abort(kGone, 2);
  EXPECT_EQ(told_, (std::vector<std::string>{"7", "stopping"}));
}

TEST_F(SequenceTest, AServeFromInsideDoesNothing) {
  std::optional<Sequence> sequence;
  const auto body = [&](int* entered) -> Sequence {
    ++*entered;
    sequence->serve(1);
    (void)co_await Sequence::Until([](std::int64_t) { return true; }, 100, kLate);
    sequence->serve(1);
  };
  int entered = 0;
  sequence.emplace(body(&entered));
  sequence->serve(1);
  EXPECT_EQ(entered, 1);
  EXPECT_TRUE(sequence->done());
}

TEST_F(SequenceTest, WhatItThrowsComesOutOfServeAndEndsIt) {
  const auto body = [](bool wait) -> Sequence {
    if (wait) (void)co_await Sequence::Until([](std::int64_t now_ns) { return now_ns > 5; }, 100, kLate);
    throw std::string("wrong");
  };
  Sequence sequence = body(true);
  sequence.serve(1);
  EXPECT_THROW(sequence.serve(6), std::string);
  EXPECT_TRUE(sequence.done());
}

TEST_F(SequenceTest, OneThatIsDestroyedWhileItWaitsFreesWhatItHolds) {
  const auto held = std::make_shared<int>(1);
  const auto body = [](std::shared_ptr<int> mine) -> Sequence {
    (void)co_await Sequence::Until([](std::int64_t) { return false; }, 100, kLate);
    ++*mine;
  };
  {
    Sequence sequence = body(held);
    sequence.serve(1);
    EXPECT_EQ(held.use_count(), 2);
  }
  EXPECT_EQ(held.use_count(), 1);
  EXPECT_EQ(*held, 1);
}

}  // namespace
}  // namespace lithe::control
