// SPDX-License-Identifier: Apache-2.0
// The Brain's inputs to a law, from shared memory to the law: all or none, within their ranges, fresh or stale.
#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include "spine/loop/test/laws_rig.hpp"

namespace lithe::loop {
namespace {

struct Follow {
  struct Params {};
  struct State {};
  struct Probes {
    double input = 0, age_s = 0, stale = 0;
  };
  static void step(const Tick& t, const Params&, State&, Effort& u, Probes& p) {
    u.torque_nm[0] = t.input[0];
    p = {t.input[0], t.input_age_s, (t.flags & kInputStale) != 0 ? 1.0 : 0.0};
  }
};
constexpr LitheLaw kFollow = describe<Follow>("follow");

class InputsTest : public LawsTest {
 protected:
  void give(std::uint32_t count, double push_nm) {
    wire::Inputs inputs;
    inputs.count = count;
    inputs.value[0] = push_nm;
    inputs.value[1] = 77;  // of no input
    ipc::ChannelWriter<wire::Inputs>(brain_memory_->inputs).write(inputs);
  }
};

TEST_F(InputsTest, ALawHasThemFromTheNextTickOnUntilTheyAreStale) {
  arm_with(kFollow);
  EXPECT_EQ(record_.probe[0], 0) << "the file's value";
  EXPECT_TRUE(std::isinf(record_.probe[1])) << "none has come yet";
  EXPECT_EQ(record_.probe[2], 1);
  EXPECT_EQ(record_.input_age_ns, -1);
  give(1, -0.5);
  tick();
  EXPECT_EQ(record_.probe[0], -0.5);
  EXPECT_EQ(record_.probe[1], 0);
  EXPECT_EQ(record_.probe[2], 0);
  EXPECT_EQ(record_.input[0], -0.5);
  EXPECT_EQ(record_.input[1], 0) << "no more than the robot has";
  ticks(90);
  EXPECT_EQ(record_.probe[2], 0) << "stale_after_s is 0.1";
  ticks(20);
  EXPECT_EQ(record_.probe[2], 1);
  EXPECT_EQ(record_.probe[0], -0.5) << "a stale one keeps its value: the law decides";
  EXPECT_NEAR(record_.probe[1], 0.11, 1e-9);
  EXPECT_EQ(record_.input_age_ns, 110 * kNsPerMs);
}

TEST_F(InputsTest, WhatIsOutOfRangeIsRefusedWholeAndToldOnce) {
  arm_with(kFollow);
  give(1, 0.25);
  tick();
  const std::vector<double> bad{0.2500001, -0.51, std::numeric_limits<double>::quiet_NaN(),
                                std::numeric_limits<double>::infinity(), -std::numeric_limits<double>::infinity()};
  for (const double value : bad) {
    give(1, value);
    tick();
    EXPECT_EQ(record_.input[0], 0.25) << value;
  }
  give(2, 0.1);
  tick();
  EXPECT_EQ(record_.input[0], 0.25) << "two inputs for a robot that has one";
  std::vector<wire::Event> told = events(EventKind::inputs_refused);
  ASSERT_EQ(told.size(), 1U) << "one for a row of them";
  EXPECT_EQ(std::string(told[0].text.data()), "push_nm = 0.250, allowed -0.500 to 0.250");
  EXPECT_EQ(record_.input_age_ns, 6 * kNsPerMs) << "what is refused does not make it fresh";
  give(1, 0.1);
  tick();
  EXPECT_EQ(record_.input[0], 0.1);
  give(0, 0);
  tick();
  told = events(EventKind::inputs_refused);
  ASSERT_EQ(told.size(), 2U);
  EXPECT_EQ(std::string(told[1].text.data()), "0 inputs, the robot has 1");
}

}  // namespace
}  // namespace lithe::loop
