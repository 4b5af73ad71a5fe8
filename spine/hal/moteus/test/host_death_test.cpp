// SPDX-License-Identifier: Apache-2.0
// The computer dies while it holds an arm up: what the drive does with the last frame it got decides how the arm comes
// down.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "spine/hal/moteus/test/moteus_line_rig.hpp"

namespace lithe::hal {
namespace {

constexpr double kMglNm = 0.165;
constexpr double kSafeKd = 0.04;
constexpr double kWatchdogS = 0.1;

// The desk arm's bar, level, held by torque alone as a law with gravity compensation does it.
class LevelArm {
 public:
  LevelArm(double damp_kd_nm_s_rad, double drive_kd_nm_s_rev)
      : line_(driver(damp_kd_nm_s_rad), arm(drive_kd_nm_s_rev)) {
    line_.act(DriveAction::off, 20);
    EXPECT_TRUE(line_.ready());
    hold(1500);
    EXPECT_EQ(line_.mode(), 10U);
    EXPECT_NEAR(line_.state.position_rad[0], std::numbers::pi / 2, 0.1) << "held";
  }

  // Nobody says anything any more; the fastest that the bar becomes on its way down [rad/s].
  double peak_after_death() {
    double peak = 0;
    FrameQueue nobody;
    for (int ms = 0; ms < 3000; ++ms) {
      line_.now_ns += MoteusLine::kMs;
      line_.node.drive().on_time(line_.now_ns, nobody);
      peak = std::max(peak, std::abs(line_.node.drive().servo().plant().velocity_rad_s()));
    }
    return peak;
  }
  double peak_when_let_go() {
    line_.act(DriveAction::off, 2);
    return peak_after_death();
  }
  double peak_when_damped() {
    line_.act(DriveAction::damp, 2);
    return peak_after_death();
  }
  std::uint32_t mode_now() {
    line_.cycle();
    return line_.mode();
  }
  void hold(int ticks) {
    for (int i = 0; i < ticks; ++i) {
      const double error_rad = std::numbers::pi / 2 - line_.state.position_rad[0];
      line_.command.torque_nm[0] =
          kMglNm * std::sin(line_.state.position_rad[0]) + 0.5 * error_rad - 0.05 * line_.state.velocity_rad_s[0];
      line_.act(DriveAction::torque, 1);
    }
  }

 private:
  static moteus::DriverParams driver(double damp_kd_nm_s_rad) {
    moteus::DriverParams params = MoteusLine::asking();
    params.watchdog_s = kWatchdogS;
    params.damp_kd_nm_s_rad = damp_kd_nm_s_rad;
    params.velocity_max_rad_s = 30;
    return params;
  }
  static sim::SimMoteusParams arm(double drive_kd_nm_s_rev) {
    sim::SimMoteusParams params;
    params.servo.kd_nm_s_rev = drive_kd_nm_s_rev;
    params.plant.inertia_kg_m2 = 2.55e-3;
    params.plant.mgl_nm = kMglNm;
    params.plant.coulomb_nm = 0.0132;
    return params;
  }
  MoteusLine line_;
};

TEST(HostDeath, TheArmSinksDampedAsTheRobotFileSaysAndDoesNotFall) {
  const double limp = LevelArm(kSafeKd, 0.05).peak_when_let_go();
  EXPECT_GT(limp, 9) << "sqrt(2 mgl / J) = 11.4 less friction: the fall that is to be prevented";
  for (const double drive_kd : {0.02, 0.05, 0.5}) {
    LevelArm dead(kSafeKd, drive_kd);
    const double peak = dead.peak_after_death();
    EXPECT_LT(peak, kMglNm / kSafeKd) << "the speed at which damping carries the weight; drive's own kd " << drive_kd;
    EXPECT_LT(peak, 0.4 * limp);
    EXPECT_EQ(dead.mode_now(), 11U) << "its watchdog did that";
  }
}

// The twin: commands without damping of their own, as they were once sent. Nothing holds the arm.
TEST(HostDeath, WithoutDampingInTheLastCommandItFalls) {
  const double limp = LevelArm(0, 0.05).peak_when_let_go();
  EXPECT_GT(LevelArm(0, 0.05).peak_after_death(), 0.95 * limp);
}

TEST(HostDeath, TheEmergencyStopDampsAlike) {
  for (const double drive_kd : {0.02, 0.5}) EXPECT_LT(LevelArm(kSafeKd, drive_kd).peak_when_damped(), kMglNm / kSafeKd);
}

}  // namespace
}  // namespace lithe::hal
