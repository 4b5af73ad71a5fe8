// SPDX-License-Identifier: Apache-2.0
#include "spine/law/diagnosis.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <numbers>
#include <string>

namespace lithe::law {
namespace {

using Cause = Diagnosis::Kind;
constexpr double kTorqueMaxNm = 2, kInertia = 0.02, kDt = 1e-3;

struct In {
  double setpoint_rad, position_rad, velocity_rad_s, setpoint_rad_s;
};

// One second of one joint under a law; its setpoint moves by 0.3 rad and back.
JointSums run(const std::function<double(const In&)>& law, double load_nm = 0, int ticks = 1000) {
  JointSums sums;
  double position_rad = 0, velocity_rad_s = 1;  // a push, so that position and setpoint differ
  for (int k = 0; k < ticks; ++k) {
    const double w = 2 * std::numbers::pi, t_s = k * kDt;
    const In in{0.15 * (1 - std::cos(w * t_s)), position_rad, velocity_rad_s, 0.15 * w * std::sin(w * t_s)};
    const double wanted_nm = law(in);
    sums.see({in.setpoint_rad, in.position_rad, in.velocity_rad_s, in.setpoint_rad_s, wanted_nm}, kTorqueMaxNm);
    const double given_nm = std::clamp(wanted_nm, -kTorqueMaxNm, kTorqueMaxNm);
    velocity_rad_s += (given_nm - load_nm - 0.02 * velocity_rad_s) / kInertia * kDt;
    position_rad += velocity_rad_s * kDt;
  }
  return sums;
}

double pd(const In& in, double kp, double kd) {
  return kp * (in.setpoint_rad - in.position_rad) + kd * (in.setpoint_rad_s - in.velocity_rad_s);
}

Diagnosis found(const JointSums& sums, double swing_hz = 0, bool refused = true) {
  static constexpr double kParams[] = {0.5, 3};
  return diagnose(sums, {"elbow", kTorqueMaxNm, swing_hz, refused, kParams});
}

TEST(Diagnosis, EachCauseIsFoundFromWhatTheJointDid) {
  const struct Case {
    Cause kind;
    const char* says;
    Diagnosis diagnosis;
  } cases[] = {
      {Cause::no_torque, "no torque at all", found(run([](const In&) { return 0; }, 0.1))},
      {Cause::wrong_sign, "measured: +3 N m per rad", found(run([](const In& in) { return -pd(in, 3, 0); }, 0, 600))},
      {Cause::wrong_damping_sign, "begin with a gain of 0.05",
       found(run([](const In& in) { return pd(in, 3, 0) + 0.2 * in.velocity_rad_s; }, 0, 500))},
      {Cause::degrees, "172 and 3", found(run([](const In& in) {
         return 3 * (in.setpoint_rad - in.position_rad * 180 / std::numbers::pi) - 0.2 * in.velocity_rad_s;
       }))},
      {Cause::degrees, "57.3 times the parameter 3",
       found(run([](const In& in) { return pd(in, 3 * 180 / std::numbers::pi, 0.2); }))},
      {Cause::no_damping, "gain of about 0.04",
       found(run([](const In& in) { return 4 * (in.setpoint_rad - in.position_rad); }), 16)},
      {Cause::gain_too_high, "lower the stiffness to about 10 and the damping to about 0.15",
       found(run([](const In& in) { return pd(in, 40, 0.3); }), 8)},
      {Cause::gain_too_high, "lower the stiffness to about 10 and the damping to about 0.075",
       found(run([](const In& in) { return pd(in, 40, 0.3); }), 40)},
      {Cause::gain_too_high, "an error of 0.05 rad asks for all of its 2 N m: lower the stiffness to about 10",
       found(run([](const In& in) { return pd(in, 40, 0.3); }, 2.5))},
      {Cause::gain_too_high, "it swings at 50.0 Hz: lower the stiffness to about 0.125 and the damping to about 0.25",
       found(run([](const In& in) { return 0.5 * (in.setpoint_rad - in.position_rad) - in.velocity_rad_s; }), 50)},
      {Cause::steady_load, "or an integral with a gain of about 21 N m",
       found(run([](const In& in) { return pd(in, 5, 0.2); }, 0.5), 0, false)},
  };
  for (const auto& each : cases) {
    EXPECT_EQ(each.diagnosis.kind, each.kind) << each.says << ": " << each.diagnosis.text.data();
    EXPECT_NE(std::string(each.diagnosis.text.data()).find(each.says), std::string::npos) << each.diagnosis.text.data();
    EXPECT_NE(std::string(each.diagnosis.text.data()).find("joint elbow"), std::string::npos);
  }
}

// A stiffness that a fit would find, and a shake that blames it: the joint does not move at all.
TEST(Diagnosis, AJointThatDoesNotMoveIsToldBeforeItsGains) {
  const auto stuck = [](double kp) {
    JointSums sums;
    for (int k = 0; k < 1000; ++k) {
      const double w = 2 * std::numbers::pi, t_s = k * kDt, setpoint_rad = 0.15 * (1 - std::cos(w * t_s));
      const double noise_rad = 1e-4 * (k % 2), noise_rad_s = 1e-3 * (k % 3);  // of an encoder
      sums.see({setpoint_rad, noise_rad, noise_rad_s, 0.15 * w * std::sin(w * t_s), kp * (setpoint_rad - noise_rad)},
               kTorqueMaxNm);
    }
    return found(sums);
  };
  EXPECT_EQ(stuck(2).kind, Cause::stalled);
  EXPECT_NE(std::string(stuck(2).text.data()).find("at most 0.6 of its 2 N m"), std::string::npos);
  EXPECT_EQ(stuck(20).kind, Cause::stalled);
  EXPECT_NE(std::string(stuck(20).text.data()).find("gains do not help"), std::string::npos);
}

TEST(Diagnosis, AnIntegralThatWindsUpIsFound) {
  double sum = 0;
  const auto integral = [&sum](const In& in) {
    sum += 200 * (in.setpoint_rad - in.position_rad) * kDt;
    return sum + pd(in, 3, 0.1);
  };
  const Diagnosis diagnosis = found(run(integral, 0, 1000));
  EXPECT_EQ(diagnosis.kind, Cause::wind_up) << diagnosis.text.data();
}

TEST(Diagnosis, WhatIsNotClearIsNotSaid) {
  EXPECT_EQ(found(run([](const In& in) { return pd(in, 20, 0.6); }), 0, false).kind, Cause::none) << "a good law";
  EXPECT_EQ(found(run([](const In& in) { return pd(in, 20, 0.6); })).kind, Cause::none) << "refused for another reason";
  EXPECT_EQ(found(run([](const In& in) { return -pd(in, 3, 0); }, 0, 20)).kind, Cause::none) << "20 ticks";
  int tick = 0;
  EXPECT_EQ(found(run([&tick](const In&) { return ++tick, std::sin(0.1 * tick * tick); })).kind, Cause::none)
      << "no feedback";
  EXPECT_EQ(found(run([](const In&) { return 2.0; })).kind, Cause::none) << "all of its torque, always";
  double sum = 0;
  const auto integral = [&sum](const In& in) {
    return sum += 20 * kDt * (in.setpoint_rad - in.position_rad), sum + pd(in, 3, 0.05);
  };
  EXPECT_EQ(found(run(integral)).kind, Cause::none) << "an integral is nearly explained by the other inputs";
  EXPECT_EQ(found(run([](const In&) { return std::nan(""); })).kind, Cause::none);
}

}  // namespace
}  // namespace lithe::law
