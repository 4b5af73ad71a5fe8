// SPDX-License-Identifier: Apache-2.0
// CANopen drives on a pi3hat: nothing in their answers tells which SYNC they are to, so the board must not mix ticks.
#include <gtest/gtest.h>

#include <memory>
#include <utility>

#include "spine/core/test/no_alloc_rig.hpp"
#include "spine/hal/bus/test/pi3hat_rig.hpp"
#include "spine/hal/robot_hardware.hpp"
#include "spine/robot/robot.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::hal {
namespace {

constexpr std::size_t kJoints = 7;  // the first two are CANopen

// Five moteus drives and a gateway on JC1 and JC2, two CANopen drives on JC3.
robot::RobotConfig frankenstein() {
  Result<robot::RobotConfig> loaded = robot::load_robot(LITHE_ROBOTS "/frankenstein.toml");
  EXPECT_TRUE(loaded) << loaded.message();
  robot::RobotConfig config = *loaded;
  config.plant.ideal = true;
  for (std::size_t i = 0; i < config.buses.size(); ++i) {
    config.buses[i].kind = robot::BusKind::pi3hat;
    config.buses[i].connector = static_cast<std::uint32_t>(i + 1);
    config.buses[i].reply_wait_s = 0.005;  // of real time, also on a busy machine
  }
  return config;
}

class Pi3hatCanopen : public testing::Test {
 protected:
  void SetUp() override {
    const robot::RobotConfig config = frankenstein();
    auto made = sim::make_nodes(config);
    ASSERT_TRUE(made) << made.message();
    board_.nodes = std::move(*made);
    for (std::size_t i = 0; i < config.buses.size(); ++i) board_.nodes.attach(config, i, board_.lines[i]);
    auto opened = open_actuators(config, {.open_board = opens(board_)});
    ASSERT_TRUE(opened) << opened.message();
    actuators_ = std::move(*opened);
    for (int i = 0; i < 2000 && fresh() < kJoints; ++i) tick();
    ASSERT_EQ(fresh(), kJoints) << actuators_->why_not_ready();
  }
  void tick() {
    board_.now_ns = now_ns_ += 1'000'000;
    ++command_.tick;
    actuators_->cycle(command_, state_, now_ns_);
  }
  bool is_fresh(std::size_t joint) const { return (state_.status[joint] & wire::joint_status::kFresh) != 0; }
  std::size_t fresh() const {
    std::size_t count = 0;
    for (std::size_t i = 0; i < state_.joints; ++i) count += is_fresh(i) ? 1 : 0;
    return count;
  }
  void lose_both() {
    for (const std::size_t device : {6, 7})
      board_.nodes.devices[device].node->inject(InjectedFault::power_loss, true, now_ns_);
  }

  Board board_;
  std::unique_ptr<Actuators> actuators_;
  ActuatorCommand command_;
  ActuatorState state_;
  std::int64_t now_ns_ = 1'000'000'000;
};

TEST_F(Pi3hatCanopen, ADriveThatIsGoneIsMissedInTheVeryNextTick) {
  lose_both();
  tick();
  EXPECT_FALSE(is_fresh(0));
  EXPECT_FALSE(is_fresh(1));
}

TEST_F(Pi3hatCanopen, AnswersThatComeInTheNextTickAreLateAndNeverTakenForIts) {
  const std::uint64_t late = actuators_->counters().late;
  board_.slow = true;
  for (int i = 0; i < 10; ++i) {
    tick();
    EXPECT_FALSE(is_fresh(0)) << i;
    EXPECT_FALSE(is_fresh(1)) << i;
  }
  EXPECT_GE(actuators_->counters().late, late + 4) << "until the driver takes them for dead and starts them anew";
  EXPECT_EQ(actuators_->counters().conflicting, 0U);
  EXPECT_NE(state_.status[0] & wire::joint_status::kLost, 0U);
}

TEST_F(Pi3hatCanopen, ATickAllocatesNothing) {
  const NoAllocScope scope;
  for (int i = 0; i < 5; ++i) tick();
}

}  // namespace
}  // namespace lithe::hal
