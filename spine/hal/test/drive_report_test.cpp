// SPDX-License-Identifier: Apache-2.0
// What drives tell of themselves, from the simulated device's frames to the memory map.
#include <gtest/gtest.h>

#include <cmath>

#include "spine/hal/cia402/test/cia402_line_rig.hpp"
#include "spine/hal/moteus/test/moteus_line_rig.hpp"

namespace lithe::hal {
namespace {

using wire::DriveState;

TEST(MoteusReport, SupplyAndTemperatureOfEveryAnswerReachTheMap) {
  MoteusLine line(MoteusLine::asking());
  EXPECT_TRUE(std::isnan(line.state.drive[0].voltage_v)) << "before the first answer nothing is told";
  line.act(DriveAction::off, 200);
  EXPECT_EQ(line.state.drive[0].state, DriveState::off);
  EXPECT_DOUBLE_EQ(line.state.drive[0].voltage_v, 24);
  EXPECT_DOUBLE_EQ(line.state.drive[0].temperature_degc, 25);
  line.node.drive().servo().set_temperature_c(61);
  line.cycle();
  EXPECT_DOUBLE_EQ(line.state.drive[0].temperature_degc, 61);
  EXPECT_TRUE(std::isnan(line.state.drive[0].current_a)) << "not asked for: it would make the answer longer";
  EXPECT_TRUE(std::isnan(line.state.drive[0].power_w));
}

TEST(MoteusReport, TheStateOfADriveIsOneWord) {
  MoteusLine line(MoteusLine::asking());
  line.act(DriveAction::off, 200);
  ASSERT_TRUE(line.ready());
  line.act(DriveAction::torque, 3);
  EXPECT_EQ(line.state.drive[0].state, DriveState::enabling) << "it calibrates first";
  line.act(DriveAction::torque, 20);
  EXPECT_EQ(line.state.drive[0].state, DriveState::driven);
  line.act(DriveAction::damp, 3);
  EXPECT_EQ(line.state.drive[0].state, DriveState::damped);
  line.act(DriveAction::torque, 3);
  line.node.drive().servo().expire_watchdog();
  line.cycle(2);
  EXPECT_EQ(line.state.drive[0].state, DriveState::damped);
  EXPECT_TRUE(line.has(wire::joint_status::kWatchdog));
  line.act(DriveAction::off, 3);
  line.act(DriveAction::torque, 20);
  line.node.drive().servo().set_driver_failed(true);
  line.cycle(3);
  EXPECT_EQ(line.state.drive[0].state, DriveState::fault);
}

TEST(MoteusReport, CurrentAndPowerAreAskedForWhereTheFormatSaysSo) {
  for (const double sign : {1.0, -1.0}) {
    moteus::DriverParams driver = MoteusLine::asking();
    driver.joint.sign = sign;
    driver.frames.current = moteus::Format::int16;
    driver.frames.power = moteus::Format::float32;
    sim::SimMoteusParams params;
    params.joint.sign = sign;
    MoteusLine line(driver, params);
    line.act(DriveAction::off, 200);
    line.command.torque_nm[0] = 0.1;
    line.act(DriveAction::torque, 30);
    const DriveReport& told = line.state.drive[0];
    const double expected_a = line.state.torque_nm[0] / sim::ServoParams{}.torque_constant_nm_a;
    EXPECT_GT(told.current_a, 1.0) << "signed like the torque of the joint";
    EXPECT_NEAR(told.current_a, expected_a, 0.2);
    EXPECT_NEAR(told.power_w, line.state.torque_nm[0] * line.state.velocity_rad_s[0], 0.05);
  }
}

class Cia402Report : public Cia402Line {
 protected:
  // The current object says something else than what is asked: `index` of an SDO answer.
  static std::uint16_t index_of(const Frame& frame) {
    return static_cast<std::uint16_t>(frame.data[1] | frame.data[2] << 8);
  }
  static bool is_answer(const Frame& frame) { return frame.id == canopen::cob::kSdoAnswer + 1; }
};

TEST_F(Cia402Report, CurrentAndSupplyComeTenTimesASecond) {
  build({.mode = cia402::Mode::torque, .joint = {-1.0, 0.3, 10.0}});
  enable();
  EXPECT_EQ(state_.drive[0].state, DriveState::driven);
  command_.torque_nm[0] = 1.0;
  cycle(300);
  EXPECT_DOUBLE_EQ(state_.drive[0].voltage_v, 24);
  const double rated_a = 10.0;  // of the simulated drive: its torque and its current are the same share of the rated
  const double share = state_.torque_nm[0] / 10.0 / 0.5;
  EXPECT_GT(state_.torque_nm[0], 0.5);
  EXPECT_NEAR(state_.drive[0].current_a, share * rated_a, 0.2) << "signed like the torque of the joint";
  EXPECT_TRUE(std::isnan(state_.drive[0].temperature_degc)) << "the profile has no object for it";
  int asked = 0;
  cables_[0]->back = [&asked](Frame& frame) {
    asked += is_answer(frame);
    return true;
  };
  cycle(1000);
  EXPECT_NEAR(asked, 20, 1) << "two objects, ten times a second";
}

TEST_F(Cia402Report, TheStateOfADriveIsOneWord) {
  build({.enable_ns = 20 * kMs});
  act(DriveAction::off, 200);
  EXPECT_EQ(state_.drive[0].state, DriveState::off);
  act(DriveAction::torque, 10);
  EXPECT_EQ(state_.drive[0].state, DriveState::enabling);
  act(DriveAction::torque, 40);
  EXPECT_EQ(state_.drive[0].state, DriveState::driven);
  command_.torque_nm[0] = 1;
  act(DriveAction::torque, 20);  // so that there is something to slow down
  command_.torque_nm[0] = 0;
  act(DriveAction::damp, 2);
  EXPECT_EQ(state_.drive[0].state, DriveState::damped);
  act(DriveAction::damp, 1000);
  EXPECT_EQ(state_.drive[0].state, DriveState::off) << "the ramp has ended";
  act(DriveAction::off, 5);
  act(DriveAction::torque, 60);
  drive().inject(0x2310);
  cycle(200);
  EXPECT_EQ(state_.drive[0].state, DriveState::fault);
}

TEST_F(Cia402Report, ADriveWithoutTheseObjectsIsNotAskedAgainAndWorks) {
  build();
  int asked = 0;
  cables_[0]->back = [&asked](Frame& frame) {
    const std::uint16_t index = is_answer(frame) ? index_of(frame) : 0;
    if (index != cia402::object::kSupply && index != cia402::object::kRatedCurrent) return true;
    ++asked;
    frame = canopen::sdo_abort(canopen::cob::kSdoAnswer + 1, {index, 0}, canopen::abort_code::kNoObject);
    return true;
  };
  enable();
  cycle(2000);
  EXPECT_EQ(asked, 2) << "once each";
  EXPECT_TRUE(std::isnan(state_.drive[0].voltage_v));
  EXPECT_TRUE(std::isnan(state_.drive[0].current_a)) << "a share of an unknown rating";
  EXPECT_EQ(state_.drive[0].state, DriveState::driven);
  EXPECT_FALSE(has(wire::joint_status::kFault));
}

}  // namespace
}  // namespace lithe::hal
