// SPDX-License-Identifier: Apache-2.0
// Every law in laws/, compiled as `lithe swap` compiles it, loaded and stepped: the values must be those of its
// formula.
#include <dlfcn.h>
#include <gtest/gtest.h>

#include <cmath>

#include "lawd/run/files.hpp"
#include "lawd/test/lawd_rig.hpp"
#include "spine/law/resident.hpp"

namespace lithe::lawd {
namespace {

class LawsTest : public ::testing::Test {
 protected:
  void load(const std::string& name) {
    const auto source = read_file(std::string(LITHE_LAWS_DIR) + "/" + name + ".cpp");
    ASSERT_TRUE(source.has_value());
    const nlohmann::json reply = compile(service_, *source, name + ".cpp");
    ASSERT_TRUE(reply["ok"]) << reply["text"];
    EXPECT_EQ(reply["warnings"], "");
    EXPECT_EQ(reply["law"]["name"], name);
    handle_ = dlopen(reply["object"].get<std::string>().c_str(), RTLD_NOW | RTLD_LOCAL);
    ASSERT_NE(handle_, nullptr) << dlerror();
    law::reset_resident(law_, *static_cast<const LitheLaw*>(dlsym(handle_, "lithe_law")));
    t_.joints = 2;
    t_.dt_s = 1e-3;
    t_.position_rad = {0.3, -0.7};
    t_.velocity_rad_s = {1.5, -2.0};
    t_.setpoint_position_rad = {0.5, -1.0};
    t_.setpoint_velocity_rad_s = {0.4, 0.6};
    t_.setpoint_acceleration_rad_s2 = {3.0, -4.0};
  }
  void TearDown() override {
    if (handle_ != nullptr) dlclose(handle_);
  }
  void set(const std::string& name, double value) {
    if (law_.descriptor == nullptr) return;  // load() has said why
    for (std::uint32_t i = 0; i < law_.descriptor->param_count; ++i) {
      if (name != law_.descriptor->params[i].name) continue;
      EXPECT_TRUE(law_.set_param(i, value)) << name;
      return;
    }
    ADD_FAILURE() << "no param " << name;
  }
  double torque_nm(std::uint32_t joint) {
    if (law_.descriptor == nullptr) return std::nan("");
    law_.step(t_, u_, probes_);
    return u_.torque_nm[joint];
  }

  TestCache cache_;
  Service service_{cache_.path()};
  void* handle_ = nullptr;
  law::Resident law_;
  Tick t_;
  Effort u_;
  std::array<double, kMaxProbes> probes_{};
};

TEST_F(LawsTest, PdPullsToTheSetpoint) {
  load("pd");
  set("kp_nm_rad", 10);
  set("kd_nm_s_rad", 2);
  EXPECT_DOUBLE_EQ(torque_nm(0), 10 * 0.2 + 2 * (0.4 - 1.5));
  EXPECT_DOUBLE_EQ(torque_nm(1), 10 * -0.3 + 2 * (0.6 + 2.0));
  EXPECT_EQ(u_.torque_nm[2], 0) << "no torque beyond the robot's joints";
}

TEST_F(LawsTest, HoldKeepsWhereItStarted) {
  load("hold");
  EXPECT_DOUBLE_EQ(torque_nm(0), -0.1 * 1.5);
  t_.position_rad[0] = 0.4;
  t_.velocity_rad_s[0] = 0;
  EXPECT_DOUBLE_EQ(torque_nm(0), 4.0 * (0.3 - 0.4));
}

TEST_F(LawsTest, GravityPdAddsWhatGravityTakes) {
  load("gravity_pd");
  set("mgl_nm", 0.165);
  EXPECT_DOUBLE_EQ(torque_nm(1), 0.165 * std::sin(-0.7) + 4.0 * -0.3 + 0.1 * 2.6);
  EXPECT_DOUBLE_EQ(probes_[0], 0.165 * std::sin(0.3));
}

TEST_F(LawsTest, ConstantTorqueRampsUpAndStays) {
  load("constant_torque");
  set("tau_nm", 0.1);
  t_.velocity_rad_s = {};
  EXPECT_NEAR(torque_nm(0), 0.1 * 0.005, 1e-12) << "1 ms of a 200 ms ramp";
  for (int k = 0; k < 300; ++k) torque_nm(0);
  EXPECT_DOUBLE_EQ(torque_nm(1), 0.1);
}

TEST_F(LawsTest, ImpedanceLimitsItsSpring) {
  load("impedance");
  set("inertia_kg_m2", 0.5);
  set("stiffness_nm_rad", 8);
  set("damping_ratio", 1);
  set("torque_limit_nm", 1);
  EXPECT_DOUBLE_EQ(torque_nm(0), 0.5 * 3 + 1.0 + 4 * (0.4 - 1.5)) << "the spring alone would pull 1.6 Nm";
}

TEST_F(LawsTest, LqrGainsSolveTheRiccatiEquation) {
  load("lqr");
  set("inertia_kg_m2", 0.2);
  set("w_position", 9);
  set("w_velocity", 0.5);
  set("w_effort", 2);
  torque_nm(0);
  const double kp = probes_[0], kd = probes_[1], p12 = kp * 0.2 * 2, p22 = kd * 0.2 * 2;
  EXPECT_NEAR(9 - p12 * p12 / (0.2 * 0.2 * 2), 0, 1e-9);
  EXPECT_NEAR(0.5 + 2 * p12 - p22 * p22 / (0.2 * 0.2 * 2), 0, 1e-9);
  EXPECT_DOUBLE_EQ(u_.torque_nm[0], 0.2 * 3 + kp * 0.2 + kd * (0.4 - 1.5));
}

TEST_F(LawsTest, ReflexTurnsBackInTheTickInWhichItIsTouched) {
  load("reflex");
  set("threshold", 5);
  set("hold_s", 0.002);
  set("back_s", 0.099);
  const auto pd_nm = [this](double target_rad, double target_rad_s, std::size_t j) {
    return 2.0 * (target_rad - t_.position_rad[j]) + 0.05 * (target_rad_s - t_.velocity_rad_s[j]);
  };
  t_.sensor.fill(6);
  EXPECT_DOUBLE_EQ(torque_nm(0), pd_nm(0.5, 0.4, 0)) << "no sensor is chosen";
  set("sensor", 3);
  t_.sensor.fill(kAbsent);
  EXPECT_DOUBLE_EQ(torque_nm(0), pd_nm(0.5, 0.4, 0)) << "a sensor that is not valid triggers nothing";
  t_.sensor[3] = 4.9;
  t_.position_rad = {0.4, -0.9};
  EXPECT_DOUBLE_EQ(torque_nm(0), pd_nm(0.5, 0.4, 0));
  const double behind_rad[] = {0.3 + 0.01 * 0.1, -0.7 - 0.01 * 0.2};
  t_.sensor[3] = 5;
  EXPECT_DOUBLE_EQ(torque_nm(0), pd_nm(behind_rad[0], 0, 0));
  EXPECT_DOUBLE_EQ(u_.torque_nm[1], pd_nm(behind_rad[1], 0, 1)) << "each from where it came";
  t_.position_rad[0] = 0.25;
  EXPECT_DOUBLE_EQ(torque_nm(0), pd_nm(behind_rad[0], 0, 0)) << "one touch, one way back";
  t_.sensor[3] = 0;
  for (int k = 0; k < 2; ++k) EXPECT_DOUBLE_EQ(torque_nm(0), pd_nm(behind_rad[0], 0, 0)) << "hold_s after the touch";
  torque_nm(0);
  EXPECT_DOUBLE_EQ(torque_nm(0), pd_nm(0.5, 0.4, 0));
  EXPECT_EQ(probes_[0], 0);
}

}  // namespace
}  // namespace lithe::lawd
