// SPDX-License-Identifier: Apache-2.0
// Exchanges with buses that are slower than memory, drives that are asked less often, and sensors beside them.
#include <gtest/gtest.h>

#include <cmath>
#include <memory>
#include <vector>

#include "spine/core/test/units_rig.hpp"
#include "spine/core/time.hpp"
#include "spine/hal/bus/loop/loop_bus.hpp"
#include "spine/hal/bus_actuators.hpp"
#include "spine/hal/gateway/sim/sim_gateway.hpp"
#include "spine/hal/moteus/moteus.hpp"
#include "spine/hal/moteus/sim/sim_moteus.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::hal {
namespace {

// A loop whose answers arrive a while after flush(), and which goes on saying so for `wait_ns`.
class SlowBus final : public Bus {
 public:
  SlowBus(std::int64_t delay_ns, std::int64_t wait_ns) : delay_ns_(delay_ns), wait_ns_(wait_ns) {}

  void attach(BusNode& node) { loop_.attach(node); }
  void begin(std::int64_t now_ns) LITHE_RT override { loop_.begin(now_ns); }
  // Exchanges in which somebody looked in vain until nothing more could come.
  int waits_in_vain() const { return in_vain_; }
  bool send(const Frame& frame) LITHE_RT override {
    ++statistics_.sent;
    return loop_.send(frame);
  }
  void flush() LITHE_RT override {
    flushed_ns_ = clock_.now_ns();
    waited_ = false;
  }
  bool receive(Frame& frame) LITHE_RT override {
    const std::int64_t since_ns = clock_.now_ns() - flushed_ns_;
    if (since_ns >= wait_ns_ && flushed_ns_ != 0 && !waited_) {
      waited_ = true;
      ++in_vain_;
    }
    return since_ns >= delay_ns_ && loop_.receive(frame);
  }
  std::int64_t reply_wait_ns() const LITHE_RT override { return wait_ns_; }

 private:
  LoopBus loop_;
  RawClock clock_ = RawClock::calibrate(kMs);
  std::int64_t delay_ns_, wait_ns_;
  std::int64_t flushed_ns_ = 0;
  bool waited_ = false;
  int in_vain_ = 0;
};

struct Robot {
  explicit Robot(std::int64_t delay_ns, std::int64_t wait_ns) : actuators(RawClock::calibrate(kMs)) {
    auto own = std::make_unique<SlowBus>(delay_ns, wait_ns);
    bus = own.get();
    actuators.add_bus(std::move(own), hal::moteus::device_of);
  }
  void add_drive(std::uint32_t id, std::uint32_t divider = 1) {
    sim::SimMoteusParams params;
    params.id = id;
    drives.push_back(std::make_unique<sim::SimMoteus>(params));
    bus->attach(*drives.back());
    moteus::DriverParams driver;
    driver.id = id;
    actuators.add_joint(0, id, std::make_unique<moteus::MoteusDrive>(driver), divider);
    command.joints = static_cast<std::uint32_t>(drives.size());
  }
  void cycle() {
    now_ns += kMs;
    actuators.cycle(command, state, now_ns);
  }
  bool fresh(std::size_t joint) const { return (state.status[joint] & wire::joint_status::kFresh) != 0; }

  std::vector<std::unique_ptr<sim::SimMoteus>> drives;
  BusActuators actuators;
  SlowBus* bus;
  ActuatorCommand command;
  ActuatorState state;
  std::int64_t now_ns = 1'000 * kMs;
};

TEST(Exchange, AnAnswerWithinTheBussTimeIsWaitedFor) {
  Robot robot(300'000, 50 * kMs);
  robot.add_drive(1);
  robot.add_drive(2);
  for (int i = 0; i < 20; ++i) robot.cycle();
  EXPECT_EQ(robot.actuators.counters().missed, 0U);
  EXPECT_TRUE(robot.fresh(0) && robot.fresh(1));
}

TEST(Exchange, OneThatComesLaterIsMissedAndTheWaitIsBounded) {
  Robot robot(500 * kMs, kMs);
  robot.add_drive(1);
  const std::int64_t from_ns = monotonic_ns();
  for (int i = 0; i < 3; ++i) robot.cycle();
  EXPECT_GE(monotonic_ns() - from_ns, 3 * kMs);
  EXPECT_EQ(robot.actuators.counters().missed, 3U);
  EXPECT_NE(robot.state.status[0] & wire::joint_status::kLost, 0U);
}

TEST(Exchange, ALostDriveIsAskedButNotWaitedFor) {
  Robot robot(0, 200 * kMs);
  robot.add_drive(1);
  robot.actuators.add_joint(0, 2, std::make_unique<moteus::MoteusDrive>(moteus::DriverParams{.id = 2, .joint = {}}));
  robot.command.joints = 2;
  for (int i = 0; i < 3; ++i) robot.cycle();  // nobody has this address
  EXPECT_NE(robot.state.status[1] & wire::joint_status::kLost, 0U);
  const std::uint64_t sent = robot.bus->statistics().sent;
  const int before = robot.bus->waits_in_vain();
  for (int i = 0; i < 50; ++i) robot.cycle();
  EXPECT_LT(robot.bus->waits_in_vain() - before, 10) << "one of 32";
  EXPECT_EQ(robot.bus->statistics().sent - sent, 100U);
  EXPECT_TRUE(robot.fresh(0));
}

TEST(Exchange, ALostDriveIsFoundAgainWhateverItsTurn) {
  for (const std::uint32_t divider : {1U, 2U, 4U}) {
    Robot robot(200'000, 20 * kMs);
    for (std::uint32_t id = 1; id <= divider + 1; ++id) robot.add_drive(id, divider);
    const std::size_t last = divider;
    for (std::uint32_t i = 0; i < 2 * divider; ++i) robot.cycle();
    EXPECT_TRUE(robot.fresh(last));
    robot.drives[last]->restart(robot.now_ns + 6 * divider * kMs);
    robot.drives[last - 1]->restart(robot.now_ns + 6 * divider * kMs);
    for (std::uint32_t i = 0; i < 5 * divider; ++i) robot.cycle();
    EXPECT_NE(robot.state.status[last] & wire::joint_status::kLost, 0U);
    for (std::uint32_t i = 0; i < 33 * divider; ++i) robot.cycle();
    EXPECT_TRUE(robot.fresh(last)) << divider;
    EXPECT_TRUE(robot.fresh(last - 1)) << divider;
  }
}

// It answers, and that is all there is to wait for; but without a position it is not there.
TEST(Exchange, ADriveWithoutAMeasurementIsHeardButLost) {
  Robot robot(0, 200 * kMs);
  robot.add_drive(1);
  robot.add_drive(2);
  for (int i = 0; i < 3; ++i) robot.cycle();
  robot.drives[1]->servo().set_encoder_lost(true);
  const int before = robot.bus->waits_in_vain();
  for (int i = 0; i < 40; ++i) robot.cycle();
  EXPECT_LT(robot.bus->waits_in_vain() - before, 3) << "none, but for a stall of this machine";
  EXPECT_NE(robot.state.status[1] & wire::joint_status::kLost, 0U);
  EXPECT_EQ(robot.actuators.counters().missed, 40U);
  EXPECT_TRUE(robot.fresh(0));
}

// Keeps what nobody collected, as a kernel does; others talk on it unasked.
class Crowded final : public Bus {
 public:
  explicit Crowded(BusNode& drive) : drive_(drive) {}
  void begin(std::int64_t now_ns) LITHE_RT override {
    now_ns_ = now_ns;
    for (int i = 0; i < unasked; ++i) {
      Frame frame;
      frame.id = gateway::kIdBase | 9 << 8;
      frame.extended = true;
      frame.size = 8;
      frame.data[0] = ++sequence_;
      queue_.push(frame);
    }
  }
  bool send(const Frame& frame) LITHE_RT override {
    drive_.on_frame(frame, now_ns_, queue_);
    return true;
  }
  bool receive(Frame& frame) LITHE_RT override {
    const Frame* next = queue_.front();
    if (next == nullptr) return false;
    frame = *next;
    queue_.pop();
    return true;
  }
  int unasked = 0;

 private:
  BusNode& drive_;
  FrameQueue queue_;
  std::int64_t now_ns_ = 0;
  std::uint8_t sequence_ = 0;
};

TEST(Exchange, WhatOthersSaidMeanwhileNeverCostsADriveItsAnswer) {
  for (const bool known : {true, false}) {
    sim::SimMoteus drive(sim::SimMoteusParams{});
    auto own = std::make_unique<Crowded>(drive);
    Crowded* bus = own.get();
    BusActuators actuators;
    actuators.add_bus(std::move(own), hal::moteus::device_of);
    actuators.add_joint(0, 1, std::make_unique<moteus::MoteusDrive>(moteus::DriverParams{.id = 1, .joint = {}}));
    if (known) actuators.add_sensors(0, std::make_unique<gateway::Gateway>(9, kMs));
    ActuatorCommand command;
    ActuatorState state;
    for (int i = 0; i < 1000; ++i) {
      bus->unasked = i == 500 ? 200 : 20;  // as after a stall
      actuators.cycle(command, state, (1000 + i) * kMs);
      ASSERT_EQ(actuators.counters().missed, 0U) << i;
    }
  }
}

TEST(Exchange, AThreadThatSharesItsCoreWaitsAllTheSame) {
  Robot robot(300'000, 50 * kMs);
  robot.add_drive(1);
  robot.actuators.share_core();
  for (int i = 0; i < 20; ++i) robot.cycle();
  EXPECT_EQ(robot.actuators.counters().missed, 0U);
}

TEST(Exchange, DrivesWithADividerTakeTurnsAndKeepWhatTheyHad) {
  Robot robot(0, 0);
  for (std::uint32_t id = 1; id <= 4; ++id) robot.add_drive(id, 4);
  for (int i = 0; i < 8; ++i) robot.cycle();
  for (int i = 0; i < 40; ++i) {
    const std::uint64_t before = robot.bus->statistics().sent;
    robot.cycle();
    EXPECT_EQ(robot.bus->statistics().sent - before, 1U) << i;
    for (std::size_t joint = 0; joint < 4; ++joint) EXPECT_TRUE(robot.fresh(joint)) << i;
  }
  EXPECT_EQ(robot.actuators.counters().missed, 0U);
}

TEST(Exchange, SensorsComeBesideTheDrivesAndFallSilentAlone) {
  Robot robot(0, 0);
  robot.add_drive(1);
  auto gateway = std::make_unique<sim::SimGateway>(9, kMs, true);
  auto deaf = std::make_unique<sim::SimGateway>(8, 3600'000 * kMs, true);
  robot.bus->attach(*gateway);
  robot.bus->attach(*deaf);
  const std::size_t heard = robot.actuators.add_sensors(0, std::make_unique<gateway::Gateway>(9, 50 * kMs));
  const std::size_t silent = robot.actuators.add_sensors(0, std::make_unique<gateway::Gateway>(7, 50 * kMs));
  robot.actuators.add_sensor(heard, gateway::Block::imu, 9, 0.01, 0.0);
  robot.actuators.add_sensor(silent, gateway::Block::analog, 0, 1.0, 0.0);
  robot.actuators.add_sensor(heard, gateway::Block::digital, 3, 1.0, 5.0);
  robot.cycle();
  EXPECT_EQ(robot.state.sensors, 3U);
  EXPECT_TRUE(std::isnan(robot.state.sensor[0])) << "nothing came yet";
  for (int i = 0; i < 10; ++i) robot.cycle();
  EXPECT_NEAR(robot.state.sensor[0], 9.81, 1e-9);
  EXPECT_TRUE(std::isnan(robot.state.sensor[1])) << "of a gateway that is not there";
  EXPECT_TRUE(robot.state.sensor[2] == 5 || robot.state.sensor[2] == 6);
  EXPECT_TRUE(std::isnan(robot.state.sensor[3])) << "no such sensor";
  EXPECT_TRUE(robot.fresh(0));
  EXPECT_GT(robot.actuators.counters().stray, 0U) << "node 8 is in no robot file";
  gateway->unplug_input(gateway::Block::imu, 9);
  for (int i = 0; i < 10; ++i) robot.cycle();
  EXPECT_TRUE(std::isnan(robot.state.sensor[0]));
}

// A gateway that says each of its frames twice, and now and then half a frame.
class Stutter final : public BusNode {
 public:
  void on_frame(const Frame&, std::int64_t, FrameQueue&) LITHE_RT override {}
  void on_time(std::int64_t, FrameQueue& answers) LITHE_RT override {
    Frame frame;
    frame.id = gateway::kIdBase | 9U << 8;
    frame.extended = true;
    frame.size = 6;
    frame.data[0] = ++sequence_;
    answers.push(frame);
    answers.push(frame);
    frame.size = 3;
    answers.push(frame);
  }

 private:
  std::uint8_t sequence_ = 0;
};

TEST(Exchange, AGatewaysNonsenseIsCountedWithTheDrives) {
  Robot robot(0, 0);
  robot.add_drive(1);
  Stutter gateway;
  robot.bus->attach(gateway);
  const std::size_t place = robot.actuators.add_sensors(0, std::make_unique<gateway::Gateway>(9, 50 * kMs));
  robot.actuators.add_sensor(place, gateway::Block::analog, 0, 1.0, 0.5);
  for (int i = 0; i < 10; ++i) robot.cycle();
  EXPECT_EQ(robot.state.sensor[0], 0.5);
  EXPECT_EQ(robot.actuators.counters().duplicate, 10U);
  EXPECT_EQ(robot.actuators.counters().malformed, 10U);
  EXPECT_EQ(robot.actuators.counters().missed, 0U);
}

}  // namespace
}  // namespace lithe::hal
