// SPDX-License-Identifier: Apache-2.0
// Robots on a pi3hat: the adapter whole, over a board of ours with simulated drives on its five buses.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <memory>
#include <numbers>
#include <string>
#include <vector>

#include "spine/core/test/no_alloc_rig.hpp"
#include "spine/hal/bus/pi3hat/pi3hat_bus.hpp"
#include "spine/hal/bus/test/pi3hat_rig.hpp"
#include "spine/hal/open_bus.hpp"
#include "spine/hal/robot_hardware.hpp"
#include "spine/hal/sim/simulate.hpp"
#include "spine/robot/robot.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::hal {
namespace {

// The quadruped as on the robot, with an IMU.
robot::RobotConfig quadruped() {
  Result<robot::RobotConfig> loaded = robot::load_robot(LITHE_ROBOTS "/quadruped.toml");
  EXPECT_TRUE(loaded) << loaded.message();
  robot::RobotConfig config = *loaded;
  for (std::size_t i = 0; i < config.buses.size(); ++i) {
    config.buses[i].kind = robot::BusKind::pi3hat;
    config.buses[i].connector = static_cast<std::uint32_t>(i + 1);
  }
  return config;
}

class Pi3hat : public testing::Test {
 protected:
  void open(const robot::RobotConfig& config) {
    auto made = sim::make_nodes(config);
    ASSERT_TRUE(made) << made.message();
    board_.nodes = std::move(*made);
    for (std::size_t i = 0; i < config.buses.size(); ++i)
      board_.nodes.attach(config, i, board_.lines[config.buses[i].connector - 1]);
    auto opened = open_actuators(config, {.open_board = opens(board_)});
    ASSERT_TRUE(opened) << opened.message();
    actuators_ = std::move(*opened);
  }
  void tick(int times = 1) {
    for (int i = 0; i < times; ++i) {
      board_.now_ns = now_ns_ += 1'000'000;
      ++command_.tick;
      actuators_->cycle(command_, state_, now_ns_);
    }
  }
  int fresh() const {
    int count = 0;
    for (std::uint32_t i = 0; i < state_.joints; ++i) count += (state_.status[i] & wire::joint_status::kFresh) != 0;
    return count;
  }

  Board board_;
  std::unique_ptr<Actuators> actuators_;
  ActuatorCommand command_;
  ActuatorState state_;
  std::int64_t now_ns_ = 1'000'000'000;
};

TEST_F(Pi3hat, TwelveDrivesOnFiveBusesAnswerInOneCycleATick) {
  open(quadruped());
  tick(100);
  EXPECT_EQ(board_.cycles, 100U);
  EXPECT_EQ(board_.sent, 12U);
  EXPECT_EQ(board_.answered, 12U);
  EXPECT_EQ(board_.listen, 0b111110U);
  EXPECT_EQ(fresh(), 12);
  EXPECT_EQ(actuators_->counters().missed, 0U);
  EXPECT_EQ(actuators_->counters().stray, 0U);
  EXPECT_FALSE(board_.attitude_asked) << "nobody has a sensor on the imu";
}

TEST_F(Pi3hat, TorqueOnOneJointMovesThatJointAndNoOther) {
  open(quadruped());
  command_.act(DriveAction::torque);
  command_.joints = 12;
  command_.position_rad.fill(std::numeric_limits<double>::quiet_NaN());
  command_.max_torque_nm.fill(9.0);
  command_.torque_nm[7] = 3.0;
  tick(200);
  for (std::size_t i = 0; i < 12; ++i)
    EXPECT_EQ(std::abs(state_.position_rad[i]) > 0.02, i == 7) << i << " is at " << state_.position_rad[i];
}

TEST_F(Pi3hat, ADriveThatIsLostIsNotWaitedForInEveryTick) {
  const robot::RobotConfig config = quadruped();
  open(config);
  tick(10);
  board_.nodes.devices[0].node->inject(InjectedFault::power_loss, true, now_ns_);
  tick(10);
  EXPECT_EQ(fresh(), 11);
  EXPECT_NE(state_.status[0] & wire::joint_status::kLost, 0U);
  EXPECT_EQ(board_.sent, 12U);
  EXPECT_EQ(board_.answered, 11U);
}

TEST_F(Pi3hat, ATickAllocatesNothing) {
  open(quadruped());
  tick();
  const NoAllocScope scope;
  tick(10);
}

robot::RobotConfig with_imu(robot::RobotConfig config) {
  robot::DeviceConfig imu;
  imu.name = "body_imu";
  imu.kind = robot::DeviceKind::imu;
  imu.id = 0;
  imu.watchdog_s = 0.02;
  config.devices.push_back(imu);
  for (std::uint32_t channel = 0; channel < kImuChannels; ++channel) {
    robot::SensorConfig sensor;
    sensor.device = config.devices.size() - 1;
    sensor.kind = robot::SensorKind::imu;
    sensor.channel = channel;
    config.sensors.push_back(sensor);
  }
  return config;
}

TEST_F(Pi3hat, TheImuIsABlockOfSensorsInSiUnits) {
  open(with_imu(quadruped()));
  tick();
  EXPECT_TRUE(board_.attitude_asked);
  ASSERT_EQ(state_.sensors, 10U);
  EXPECT_EQ(state_.sensor[0], 1.0);
  EXPECT_DOUBLE_EQ(state_.sensor[5], std::numbers::pi / 2) << "90 degrees per second";
  EXPECT_EQ(state_.sensor[9], 9.8);
}

TEST_F(Pi3hat, AnAttitudeThatIsOldOrImpossibleIsNotValid) {
  open(with_imu(quadruped()));
  tick();
  board_.moves = false;
  tick(20);
  EXPECT_EQ(state_.sensor[0], 1.0) << "the board measures more seldom than we tick";
  tick();
  EXPECT_TRUE(std::isnan(state_.sensor[0]));
  board_.moves = true;
  tick();
  EXPECT_EQ(state_.sensor[0], 1.0);
  const double nan = std::numeric_limits<double>::quiet_NaN();
  for (const Pi3hatAttitude& bad : {Pi3hatAttitude{}, Pi3hatAttitude{{1, 0, 0, 0}, {nan, 0, 0}, {0, 0, 9.8}},
                                    Pi3hatAttitude{{3, 0, 0, 0}, {0, 0, 0}, {0, 0, 9.8}}}) {
    board_.attitude = bad;
    tick();
    for (std::uint32_t i = 0; i < state_.sensors; ++i) EXPECT_TRUE(std::isnan(state_.sensor[i]));
  }
}

TEST_F(Pi3hat, ARobotInMemoryHasAnImuThatLiesLevel) {
  robot::RobotConfig config = with_imu(quadruped());
  for (robot::BusConfig& bus : config.buses) bus.kind = robot::BusKind::loop;
  auto simulated = sim::simulate_actuators(config);
  ASSERT_TRUE(simulated) << simulated.message();
  (*simulated)->cycle(command_, state_, now_ns_);
  EXPECT_EQ(state_.sensor[0], 1.0);
  EXPECT_NEAR(state_.sensor[9], 9.8, 0.01);
}

TEST_F(Pi3hat, AnErrorOfTheBoardIsNamedAndAStrangeConnectorIsNobody) {
  open(quadruped());
  tick(100);  // the drives have said how they are set
  board_.unknown_connectors = 20;
  tick();
  EXPECT_EQ(fresh(), 12);
  EXPECT_EQ(actuators_->why_not_ready(), "");
  board_.error = 4;
  tick();
  EXPECT_NE(actuators_->why_not_ready().find("error 4"), std::string::npos);
  board_.error = 0;
  tick();
  EXPECT_EQ(actuators_->why_not_ready(), "");
}

class Pi3hatLines : public testing::Test {
 protected:
  void open(bool polled, std::uint32_t data_bitrate = 5'000'000) {
    std::vector<robot::BusConfig> buses(1);
    buses[0].kind = robot::BusKind::pi3hat;
    buses[0].data_bitrate = data_bitrate;
    line_ = std::move(*BusOpener(buses, polled, opens(board_)).open(buses[0]));
  }
  static Frame frame(std::uint32_t id, bool extended, bool fd, std::uint8_t size) {
    Frame made;
    made.id = id;
    made.extended = extended;
    made.fd = fd;
    made.size = size;
    return made;
  }
  Board board_;
  std::unique_ptr<Bus> line_;
};

TEST_F(Pi3hatLines, WhatTheBoardCannotSayIsRefusedAndCounted) {
  open(false);
  line_->begin(0);
  EXPECT_TRUE(line_->send(frame(0x8001, true, true, 48)));
  EXPECT_FALSE(line_->send(frame(0x8001, true, false, 8))) << "every frame of this connector is FD";
  EXPECT_FALSE(line_->send(frame(0x123, true, true, 8))) << "its number makes it a standard one";
  EXPECT_FALSE(line_->send(frame(0x8001, true, true, 47)));
  EXPECT_EQ(line_->statistics().refused, 3U);
  open(false, 0);
  EXPECT_TRUE(line_->send(frame(0x123, false, false, 8)));
  EXPECT_FALSE(line_->send(frame(0x123, false, true, 8)));
}

TEST_F(Pi3hatLines, MoreThanOneCycleHoldsIsRefusedAndTheNextStartsEmpty) {
  open(false);
  const Frame one = frame(0x8001, true, true, 8);
  std::uint64_t taken = 0;
  for (int i = 0; i < 1000; ++i) taken += line_->send(one) ? 1 : 0;
  EXPECT_EQ(taken, line_->statistics().sent);
  EXPECT_EQ(taken + line_->statistics().refused, 1000U);
  line_->flush();
  Frame got;
  EXPECT_FALSE(line_->receive(got));
  EXPECT_EQ(board_.sent, taken);
  EXPECT_TRUE(line_->send(one));
}

TEST_F(Pi3hatLines, AnAnswerIsAwaitedInThisExchangeOnly) {
  open(false);
  Frame got;
  line_->expect_answer();  // and then its drive has nothing to say
  line_->flush();
  EXPECT_FALSE(line_->receive(got));
  EXPECT_TRUE(line_->send(frame(0x8001, true, true, 8)));
  line_->flush();
  EXPECT_FALSE(line_->receive(got));
  EXPECT_EQ(board_.sent, 1U);
  EXPECT_EQ(board_.answered, 0U);
}

TEST_F(Pi3hatLines, AClassicOneGivesAllThatIsOldBeforeTheCommands) {
  open(false, 0);
  for (std::uint32_t i = 0; i < 60; ++i) board_.arrived[0].push(frame(0x100 + i, false, false, 8));
  line_->begin(0);
  Frame got;
  for (std::uint32_t i = 0; i < 60; ++i) {
    ASSERT_TRUE(line_->receive(got)) << i;
    EXPECT_EQ(got.id, 0x100 + i);
  }
  EXPECT_FALSE(line_->receive(got));
}

TEST_F(Pi3hatLines, OnlyAPolledOneLooksAgain) {
  for (const bool polled : {false, true}) {
    open(polled);
    board_.cycles = 0;
    line_->flush();
    Frame got;
    for (int i = 0; i < 5; ++i) EXPECT_FALSE(line_->receive(got));
    EXPECT_EQ(board_.cycles, polled ? 5U : 1U);
  }
}

TEST(Pi3hatHere, ABuildWithoutTheMakersLibrarySaysHowToGetIt) {
  robot::BusConfig bus;
  bus.name = "jc1";
  bus.kind = robot::BusKind::pi3hat;
  const auto opened = BusOpener({bus}, true).open(bus);
  if (opened) GTEST_SKIP() << "this machine has a pi3hat";
  EXPECT_EQ(opened.message().substr(0, 11), "bus 'jc1': ");
  EXPECT_NE(opened.message().find("pi3hat"), std::string::npos);
  EXPECT_NE(opened.message().find("-DLITHE_PI3HAT=ON"), std::string::npos);
}

}  // namespace
}  // namespace lithe::hal
