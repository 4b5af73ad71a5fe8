// SPDX-License-Identifier: Apache-2.0
// A moteus is asked how it is set before it is commanded: its gains are its own, and some settings let a joint fall.
#include "spine/hal/moteus/moteus_setup.hpp"
#include "spine/core/test/units_rig.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <memory>
#include <random>

#include "spine/hal/moteus/test/moteus_line_rig.hpp"

namespace lithe::hal {
namespace {

std::uint32_t answers_so_far = 3;

TEST(MoteusSetup, IsDoneInAFewExchangesInWhichTheJointIsSeenAndOff) {
  MoteusLine line(MoteusLine::asking());
  EXPECT_NE(line.moteus->why_not_ready().find("has not yet said"), std::string::npos);
  line.act(DriveAction::torque, 1);
  EXPECT_TRUE(line.has(wire::joint_status::kFresh));
  EXPECT_TRUE(line.has(wire::joint_status::kNotReady));
  line.cycle(5);
  EXPECT_EQ(line.mode(), 0U) << "not even when torque is asked for";
  line.cycle(20);
  EXPECT_TRUE(line.ready());
  EXPECT_EQ(line.moteus->why_not_ready(), "");
  EXPECT_EQ(line.mode(), 10U);
  EXPECT_EQ(line.actuators.counters().missed, 0U);
}

// A stiff spring: what is asked for at the joint is what the joint gets, whatever the drive's gain is.
TEST(MoteusSetup, TheDrivesOwnGainsAreScaledAndNotTheFactorys) {
  for (const double kp_nm_rev : {4.0, 50.0}) {
    sim::SimMoteusParams params;
    params.servo.kp_nm_rev = kp_nm_rev;
    params.servo.kd_nm_s_rev = kp_nm_rev / 40;
    params.plant.inertia_kg_m2 = 1e3;  // stays where it is put
    MoteusLine line(MoteusLine::asking(), params);
    line.act(DriveAction::off, 20);
    ASSERT_TRUE(line.ready());
    line.command.kp_nm_rad[0] = 2;
    line.command.position_rad[0] = 0.1;
    line.act(DriveAction::torque, 30);
    EXPECT_NEAR(line.state.torque_nm[0], 0.2, 1e-3) << kp_nm_rev;
    line.command.position_rad[0] = line.state.position_rad[0];
    line.command.kd_nm_s_rad[0] = 0.5;
    line.command.velocity_rad_s[0] = 1;
    line.cycle(30);
    EXPECT_NEAR(line.state.torque_nm[0], 0.5, 5e-3) << "damping";
  }
}

// What commands leave to the drive must be there as the robot needs it.
TEST(MoteusSetup, SettingsThatCommandsLeaveOutAreAskedForAndJudged) {
  const auto line_of = [](const sim::ServoParams& servo) {
    moteus::DriverParams driver = MoteusLine::asking();
    driver.frames.settings_in_drive = true;
    driver.watchdog_s = 0.2;
    sim::SimMoteusParams params;
    params.servo = servo;
    return std::make_unique<MoteusLine>(driver, params);
  };
  sim::ServoParams good;
  good.default_watchdog_s = 0.2;
  good.default_velocity_limit_rev_s = good.default_acceleration_limit_rev_s2 = std::nan("");
  good.integral_limit_nm = 0;
  {
    auto line = line_of(good);
    line->command.torque_nm[0] = 0.1;
    line->act(DriveAction::torque, 100);
    EXPECT_TRUE(line->ready()) << line->moteus->why_not_ready();
    EXPECT_EQ(line->mode(), 10U);
    EXPECT_NEAR(line->state.torque_nm[0], 0.1, 1e-3);
    FrameQueue none;  // the host is silent: the drive's own watchdog runs out after the time that was checked
    line->node.drive().on_time(line->now_ns + 150 * MoteusLine::kMs, none);
    EXPECT_EQ(line->node.drive().servo().mode(), moteus::Mode::position);
    line->node.drive().on_time(line->now_ns + 250 * MoteusLine::kMs, none);
    EXPECT_EQ(line->node.drive().servo().mode(), moteus::Mode::timeout);
  }
  struct Wrong {
    const char* says;
    void (*set)(sim::ServoParams&);
  };
  const Wrong all[] = {
      {"servo.default_timeout_s is 0.1", [](sim::ServoParams& p) { p.default_watchdog_s = 0.1; }},
      {"servo.default_velocity_limit is 3", [](sim::ServoParams& p) { p.default_velocity_limit_rev_s = 3; }},
      {"servo.default_accel_limit is 50", [](sim::ServoParams& p) { p.default_acceleration_limit_rev_s2 = 50; }},
      {"servo.pid_position.ilimit is 0.5", [](sim::ServoParams& p) { p.integral_limit_nm = 0.5; }},
  };
  for (const Wrong& wrong : all) {
    sim::ServoParams servo = good;
    wrong.set(servo);
    auto line = line_of(servo);
    line->act(DriveAction::torque, 100);
    EXPECT_FALSE(line->ready()) << wrong.says;
    const std::string why = line->moteus->why_not_ready();
    EXPECT_NE(why.find(wrong.says), std::string::npos) << why;
    EXPECT_NE(why.find("settings = \"command\""), std::string::npos) << "what to do: " << why;
  }
}

TEST(MoteusSetup, WholeNumbersNeedADriveWhoseOwnGainsAreLargeEnough) {
  for (const double kd_nm_s_rev : {0.05, 1.0}) {
    moteus::DriverParams driver = MoteusLine::asking();
    driver.frames.command = moteus::Format::int16;
    driver.damp_kd_nm_s_rad = 0.1;  // 0.63 Nm s per turn
    sim::SimMoteusParams params;
    params.servo.kd_nm_s_rev = kd_nm_s_rev;
    MoteusLine line(driver, params);
    line.act(DriveAction::torque, 50);
    EXPECT_EQ(line.ready(), kd_nm_s_rev == 1.0);
    const std::string why = line.moteus->why_not_ready();
    EXPECT_EQ(why.find("servo.pid_position.kd is 0.05, less than") != std::string::npos, kd_nm_s_rev != 1.0) << why;
  }
}

struct Unfit {
  const char* name;
  void (*set)(sim::ServoParams&);
};

TEST(MoteusSetup, ADriveThatWouldLetTheJointFallOrCannotBeScaledStaysOff) {
  const Unfit all[] = {
      {"servo.timeout_mode is 0", [](sim::ServoParams& p) { p.timeout_mode = 0; }},
      {"servo.timeout_mode is 7", [](sim::ServoParams& p) { p.timeout_mode = 7; }},
      {"servo.timeout_mode is 10", [](sim::ServoParams& p) { p.timeout_mode = 10; }},
      {"servo.timeout_max_torque_Nm is 0", [](sim::ServoParams& p) { p.timeout_max_torque_nm = 0; }},
      {"servo.pid_position.kd is 0", [](sim::ServoParams& p) { p.kd_nm_s_rev = 0; }},
      {"servo.pid_position.kp is 0", [](sim::ServoParams& p) { p.kp_nm_rev = 0; }},
      {"servo.pid_position.kd is nan", [](sim::ServoParams& p) { p.kd_nm_s_rev = std::nan(""); }},
      {"servo.pid_position.kp is 1e+12", [](sim::ServoParams& p) { p.kp_nm_rev = 1e12; }},
      {"servo.pid_position.kp is -4", [](sim::ServoParams& p) { p.kp_nm_rev = -4; }},
  };
  for (const Unfit& unfit : all) {
    sim::SimMoteusParams params;
    unfit.set(params.servo);
    MoteusLine line(MoteusLine::asking(), params);
    line.act(DriveAction::torque, 50);
    EXPECT_FALSE(line.ready()) << unfit.name;
    EXPECT_TRUE(line.has(wire::joint_status::kFresh)) << "but it is seen";
    EXPECT_EQ(line.mode(), 0U);
    EXPECT_NE(line.moteus->why_not_ready().find(unfit.name), std::string::npos) << line.moteus->why_not_ready();
  }
}

TEST(MoteusSetup, ADriveThatGoesOnWithoutAHostIsCommandedOnlyWhereTheRobotFilePermitsIt) {
  sim::SimMoteusParams params;
  params.servo.timeout_mode = 10;
  for (const bool may : {false, true}) {
    moteus::DriverParams driver = MoteusLine::asking();
    driver.may_hold_alone = may;
    MoteusLine line(driver, params);
    line.act(DriveAction::torque, 50);
    EXPECT_EQ(line.ready(), may) << line.moteus->why_not_ready();
    EXPECT_EQ(line.mode(), may ? 10U : 0U);
    if (may) continue;
    const std::string why = line.moteus->why_not_ready();
    for (const char* part : {"servo.timeout_mode is 10", "conf set servo.timeout_mode 12", "may_hold_alone = true"})
      EXPECT_NE(why.find(part), std::string::npos) << why;
  }
}

TEST(MoteusSetup, ADriveThatIsLeftAloneDampsWithNoMoreThanTheJointsTorqueLimit) {
  moteus::DriverParams driver = MoteusLine::asking();
  driver.damp_torque_max_nm = 0.6;
  MoteusLine line(driver);
  EXPECT_EQ(line.node.drive().servo().params().timeout_max_torque_nm, 5.0) << "as from the factory";
  line.act(DriveAction::off, 50);
  EXPECT_TRUE(line.ready()) << line.moteus->why_not_ready();
  EXPECT_NEAR(line.node.drive().servo().params().timeout_max_torque_nm, 0.6, 1e-9);
}

TEST(MoteusSetup, ADriveThatIsSetToLessIsLeftAtIt) {
  moteus::DriverParams driver = MoteusLine::asking();
  driver.damp_torque_max_nm = 0.6;
  sim::SimMoteusParams params;
  params.servo.timeout_max_torque_nm = 0.2;
  MoteusLine line(driver, params);
  line.act(DriveAction::off, 50);
  EXPECT_TRUE(line.ready());
  EXPECT_EQ(line.node.drive().servo().params().timeout_max_torque_nm, 0.2);
}

TEST(MoteusSetup, WhatSomebodyMendsIsNoticed) {
  sim::SimMoteusParams params;
  params.servo.timeout_mode = 0;
  MoteusLine line(MoteusLine::asking(), params);
  line.act(DriveAction::off, 100);
  line.tell("conf set servo.timeout_mode 12");
  line.cycle(100);
  EXPECT_FALSE(line.ready()) << "it is asked again now and then";
  EXPECT_NE(line.moteus->why_not_ready(), "");
  line.cycle(1000);
  EXPECT_TRUE(line.ready());
  EXPECT_EQ(line.moteus->why_not_ready(), "");
}

TEST(MoteusSetup, AnotherRegisterMapIsNamedAndNeverCommanded) {
  MoteusLine line(MoteusLine::asking());
  line.node.back = [](Frame& frame) LITHE_RT {
    for (std::size_t i = 0; i + 7 <= frame.size; ++i)
      if (frame.data[i] == 0x29 && frame.data[i + 1] == 0x82 && frame.data[i + 2] == 0x02) frame.data[i + 3] = 4;
    return true;
  };
  line.act(DriveAction::torque, 100);
  EXPECT_FALSE(line.ready());
  EXPECT_EQ(line.mode(), 0U);
  EXPECT_NE(line.moteus->why_not_ready().find("register 102h is 4, LITHE knows 5"), std::string::npos)
      << line.moteus->why_not_ready();
}

TEST(MoteusSetup, LostAnswersAreAskedForAgain) {
  sim::SimMoteusParams params;
  params.servo.kp_nm_rev = 12.345678;
  MoteusLine line(MoteusLine::asking(), params);
  line.node.back = [](Frame&) LITHE_RT { return (answers_so_far = answers_so_far * 5 + 1) % 7 > 1; };
  line.act(DriveAction::off, 400);
  line.node.back = nullptr;
  line.cycle(2);
  EXPECT_TRUE(line.ready());
  line.command.kp_nm_rad[0] = 12.345678 / kTurn;
  line.command.position_rad[0] = 0.001;
  line.act(DriveAction::torque, 20);
  EXPECT_NEAR(line.node.drive().servo().command().kp_scale, 1, 1e-6);
}

TEST(MoteusSetup, WhatAnotherProgramLeftInTheConsoleIsNoAnswer) {
  MoteusLine line(MoteusLine::asking());
  for (int i = 0; i < 20; ++i) line.tell("conf get servo.max_voltage");
  line.act(DriveAction::off, 60);
  ASSERT_TRUE(line.ready());
  line.command.kd_nm_s_rad[0] = 0.05 / kTurn;
  line.act(DriveAction::torque, 20);
  EXPECT_NEAR(line.node.drive().servo().command().kd_scale, 1, 1e-6) << "0.05, and not 46";
}

TEST(MoteusSetup, AConsoleThatNeverStopsTalkingIsNamed) {
  MoteusLine line(MoteusLine::asking());
  line.tell("tel fmt servo_stats 1");
  line.tell("tel rate servo_stats 1");
  line.act(DriveAction::off, 600);
  EXPECT_FALSE(line.ready());
  EXPECT_NE(line.moteus->why_not_ready().find("end other programs"), std::string::npos) << line.moteus->why_not_ready();
  line.tell("tel stop");
  line.cycle(2000);
  EXPECT_TRUE(line.ready());
}

TEST(MoteusSetup, ADriveThatWasAwayIsAskedAgainWhenItIsOff) {
  MoteusLine line(MoteusLine::asking());
  line.act(DriveAction::off, 20);
  line.act(DriveAction::torque, 20);
  line.node.back = [](Frame&) LITHE_RT { return false; };
  line.cycle(50);
  line.node.back = nullptr;
  line.tell("conf set servo.pid_position.kp 8");
  line.cycle(20);
  EXPECT_TRUE(line.ready()) << "while it drives, it goes on with what is known of it";
  line.act(DriveAction::off, 2);
  EXPECT_FALSE(line.ready());
  line.cycle(20);
  ASSERT_TRUE(line.ready());
  line.command.position_rad[0] = 0;
  line.command.kp_nm_rad[0] = 8 / kTurn;
  line.act(DriveAction::torque, 20);
  EXPECT_NEAR(line.node.drive().servo().command().kp_scale, 1, 1e-6);
}

TEST(MoteusSetup, NoBytesWhateverMakeItReadyWithGainsThatAreNone) {
  std::mt19937 random(11);
  moteus::Setup setup;
  for (int round = 0; round < 200'000; ++round) {
    Frame question;
    moteus::SubframeWriter writer(question);
    setup.ask(writer);
    ASSERT_TRUE(writer.ok());
    Frame answer;
    moteus::SubframeWriter reply(answer);
    std::array<std::uint8_t, 12> text{};
    for (std::uint8_t& c : text) c = static_cast<std::uint8_t>("0123456789.-enaifER \r\n"[random() % 22]);
    if (random() % 4 == 0) reply.reply(moteus::Format::int32, 0x102, std::array{5.0}, false);
    reply.server_data(1, {text.data(), random() % text.size()});
    if (random() % 8 == 0) answer.data[random() % 16] = static_cast<std::uint8_t>(random());
    random() % 5 == 0 ? setup.missed() : setup.on_frame(answer);
    if (!setup.ready()) continue;
    ASSERT_TRUE(setup.settings().kp_nm_rev > 0 && setup.settings().kd_nm_s_rev > 0);
    ASSERT_TRUE(std::isfinite(setup.settings().kp_nm_rev) && std::isfinite(setup.settings().kd_nm_s_rev));
    setup.restart();
  }
}

}  // namespace
}  // namespace lithe::hal
