// SPDX-License-Identifier: Apache-2.0
#include "trial/sections/law_harness.hpp"

#include <gtest/gtest.h>

#include <limits>

namespace lithe::trial {
namespace {

double half_of_smallest() {
  volatile double smallest = std::numeric_limits<double>::min();
  return smallest / 2;
}

struct Halves {
  struct Params {};
  struct State {
    double at_start = 1;
  };
  static void init(const History&, const Params&, State& s) { s.at_start = half_of_smallest(); }
  static void step(const Tick&, const Params&, State& s, Effort& u) {
    u.torque_nm[0] = s.at_start;
    u.torque_nm[1] = half_of_smallest();
  }
};
constexpr LitheLaw kHalves = describe<Halves>("halves");

// As in the Spine (spine/law/arithmetic.hpp): else the trial would measure another law than the one that runs.
TEST(LawHarness, ADenormalNumberIsZeroForALawOnly) {
  const RawClock clock = RawClock::calibrate();
  LawHarness harness(kHalves, {}, {}, clock);
  harness.reset();
  harness.step({});
  EXPECT_EQ(harness.effort().torque_nm[0], 0) << "in init";
  EXPECT_EQ(harness.effort().torque_nm[1], 0) << "in step";
  EXPECT_GT(half_of_smallest(), 0) << "for the caller";
}

}  // namespace
}  // namespace lithe::trial
