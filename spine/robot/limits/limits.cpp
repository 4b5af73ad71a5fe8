// SPDX-License-Identifier: Apache-2.0
#include "spine/robot/limits/limits.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "spine/robot/limits/stopping.hpp"

namespace lithe::robot {
namespace {

// A simulation is never exactly what is simulated: so much more load and inertia than it says, and less where that is
// worse.
constexpr double kMargin = 1.25;
// Of torque_max_nm: what simulated drives are off by.
constexpr double kTorqueError = 0.05;
// Of torque_max_nm: a load that nobody declared.
constexpr double kUnknownLoad = 0.5;
// The heaviest load that the guard still brakes against.
constexpr double kMostLoad = 0.9;

double load_of(const PlantConfig& sim) {
  constexpr double kGravity = 9.81;
  return kMargin * (sim.mgl_nm + sim.cogging_nm + kGravity * sim.payload_kg * sim.payload_m);
}

void fill_in(const RobotConfig& robot, JointConfig& joint) {
  const bool simulated = is_simulated(robot, joint);
  if (std::isnan(joint.load_max_nm)) {
    const double load_nm =
        simulated ? load_of(joint.sim) + std::max(kTorqueError, joint.sim.torque_gain_error) * joint.torque_max_nm
                  : kUnknownLoad * joint.torque_max_nm;
    joint.load_max_nm = std::min(load_nm, kMostLoad * joint.torque_max_nm);
  }
  if (std::isnan(joint.inertia_max_kg_m2)) {
    const double assumed = (joint.torque_max_nm - joint.load_max_nm) / joint.deceleration_rad_s2;
    joint.inertia_max_kg_m2 =
        simulated
            ? kMargin * (joint.sim.inertia_kg_m2 + joint.sim.payload_kg * joint.sim.payload_m * joint.sim.payload_m)
            : assumed;
    if (std::isnan(joint.inertia_min_kg_m2))
      joint.inertia_min_kg_m2 = simulated ? joint.sim.inertia_kg_m2 / kMargin : assumed / 4;
  }
  if (std::isnan(joint.inertia_min_kg_m2)) joint.inertia_min_kg_m2 = joint.inertia_max_kg_m2;
}

// Two digits, rounded by std::floor or std::ceil to the side that does what is advised.
double rounded(double value, double (*to)(double)) {
  const double digit = std::pow(10.0, std::floor(std::log10(std::max(value, 1e-12))) - 1);
  return to(value / digit) * digit;
}

void check(Reader& in, const JointConfig& joint, bool load_declared) {
  if (load_declared && joint.load_max_nm > kMostLoad * joint.torque_max_nm) {
    in.complain("load_max_nm", fmt::format("{} is more than {} of torque_max_nm = {}: what is left does not brake the "
                                           "joint; write torque_max_nm = {:.2g} or more, or give it less to carry",
                                           joint.load_max_nm, kMostLoad, joint.torque_max_nm,
                                           rounded(joint.load_max_nm / kMostLoad, std::ceil)));
  }
  if (joint.inertia_min_kg_m2 > joint.inertia_max_kg_m2) {
    in.complain("inertia_min_kg_m2", fmt::format("{} is more than inertia_max_kg_m2 = {}; exchange or correct them",
                                                 joint.inertia_min_kg_m2, joint.inertia_max_kg_m2));
  }
}

// Left over of the phase margin, at the least inertia: 20 degrees.
constexpr double kLeastMargin = 0.35;

// The largest of a gain up to `most` that leaves the margin; the smaller, the more of it.
template <class Margin>
double largest(double most, Margin margin) {
  double good = 0;
  for (int i = 0; i < 40; ++i) {
    const double middle = 0.5 * (good + most);
    (margin(middle) >= kLeastMargin ? good : most) = middle;
  }
  return rounded(good, std::floor);
}

void check_gain(Reader& in, std::string_view key, double gain, std::string_view most_key, double most) {
  if (gain > most) {
    in.complain(
        key,
        fmt::format("{:g} is more than {} = {}, the most this drive may be given; write {} = {} or less, or raise {}",
                    gain, most_key, most, key, most, most_key));
  }
}

// Left over of the phase margin with these gains, at the least inertia.
double safe_margin_rad(const RobotConfig& robot, const JointConfig& joint, double kp_nm_rad, double kd_nm_s_rad) {
  const double delay_s = reaction_s(robot, joint) + 1 / robot.rate_hz + 0.5 * drive_period_s(robot, joint);
  return phase_margin_rad(joint.inertia_min_kg_m2, kp_nm_rad, kd_nm_s_rad, delay_s);
}

// The safe law must not shake the joint that it shall stop.
void check_safe_gains(Reader& in, const RobotConfig& robot, const JointConfig& joint) {
  if (safe_gains_fit(robot, joint)) return;
  const double kd = joint.safe_kd_nm_s_rad, kp = joint.safe_kp_nm_rad;
  const auto complain = [&](std::string_view key, const std::string& gains, double most) {
    in.complain(key,
                fmt::format("{} shakes a joint of inertia_min_kg_m2 = {:g} whose torque comes {:.2g} s late; "
                            "write {} = {:.2g} or less",
                            gains, joint.inertia_min_kg_m2, reaction_s(robot, joint) + 1 / robot.rate_hz, key, most));
  };
  if (safe_margin_rad(robot, joint, 0, kd) < kLeastMargin) {
    complain("safe_kd_nm_s_rad", fmt::format("{:g}", kd),
             largest(kd, [&](double each) { return safe_margin_rad(robot, joint, 0, each); }));
  } else {
    complain("safe_kp_nm_rad", fmt::format("{:g} with safe_kd_nm_s_rad = {:g}", kp, kd),
             largest(kp, [&](double each) { return safe_margin_rad(robot, joint, each, kd); }));
  }
}

// The value of `key` from which on the joint stops inside its range from its top speed, on the way from what it is to
// `most`: two digits, rounded towards `most`. NaN: none is.
double value_that_stops(const RobotConfig& robot, JointConfig joint, double JointConfig::* key, double most) {
  const double range_rad = joint.position_max_rad - joint.position_min_rad;
  const auto stops = [&](double value) {
    joint.*key = value;
    return stopping_way_rad(robot, joint, joint.velocity_max_rad_s) <= range_rad;
  };
  double bad = joint.*key, good = most;
  if (!stops(good)) return kUnsaid;
  for (int i = 0; i < 40; ++i) {
    const double middle = 0.5 * (good + bad);
    (stops(middle) ? good : bad) = middle;
  }
  const double told = most < bad ? std::max(rounded(good, std::floor), most) : std::min(rounded(good, std::ceil), most);
  return stops(told) ? told : most;
}

// What tests/limits shows holds from this rate on.
constexpr double kLeastDriveHz = 250;

void note_rate(RobotConfig& robot, const JointConfig& joint) {
  const double drive_hz = 1 / drive_period_s(robot, joint);
  if (drive_hz >= kLeastDriveHz) return;
  robot.notes.push_back(fmt::format(
      "joint \"{}\": its drive gets a torque {:.3g} times a second; below {:g} a joint may pass its position limit "
      "(docs/hardware.md): raise rate_hz or lower rate_divider",
      joint.name, drive_hz, kLeastDriveHz));
}

}  // namespace

bool is_simulated(const RobotConfig& robot, const JointConfig& joint) {
  const DeviceConfig& device = robot.devices[joint.device];
  return robot.plant.kind == PlantKind::independent && device.bus < robot.buses.size() &&
         !is_real(robot.buses[device.bus]);
}

void forget_limits(JointConfig& joint) {
  joint.load_max_nm = joint.inertia_max_kg_m2 = joint.inertia_min_kg_m2 = kUnsaid;
}

std::string way_advice(const RobotConfig& robot, const JointConfig& joint) {
  const double range_rad = joint.position_max_rad - joint.position_min_rad;
  const double way_rad = stopping_way_rad(robot, joint, joint.velocity_max_rad_s);
  if (range_rad <= 0 || way_rad <= range_rad) return {};
  std::string mends;
  const auto offer = [&](const char* name, double JointConfig::* key, double most) {
    const double value = value_that_stops(robot, joint, key, most);
    if (std::isnan(value)) return;
    mends +=
        fmt::format("{}{} = {:.4g} or {}", mends.empty() ? "" : "; ", name, value, most < joint.*key ? "less" : "more");
  };
  offer("velocity_max_rad_s", &JointConfig::velocity_max_rad_s, 1e-3 * joint.velocity_max_rad_s);
  offer("inertia_min_kg_m2", &JointConfig::inertia_min_kg_m2, joint.inertia_max_kg_m2);
  offer("load_max_nm", &JointConfig::load_max_nm, 0);
  offer("torque_max_nm", &JointConfig::torque_max_nm, 10 * joint.torque_max_nm);
  offer("inertia_max_kg_m2", &JointConfig::inertia_max_kg_m2,
        std::max(joint.inertia_min_kg_m2, joint.inertia_max_kg_m2 / 2));
  if (mends.empty() && joint.inertia_min_kg_m2 < joint.inertia_max_kg_m2)
    mends = fmt::format("inertia_min_kg_m2 = {} first, then see what else it needs", joint.inertia_max_kg_m2);
  if (mends.empty()) mends = fmt::format("position_max_rad = {:.4g} or more", joint.position_min_rad + 1.01 * way_rad);
  return fmt::format(
      "needs {:.4g} rad to stop from velocity_max_rad_s = {:g} and has {:.4g}: the guard keeps it "
      "slower; where it is true, write {}",
      way_rad, joint.velocity_max_rad_s, range_rad, mends);
}

bool safe_gains_fit(const RobotConfig& robot, const JointConfig& joint) {
  const double kd = joint.safe_kd_nm_s_rad, kp = joint.safe_kp_nm_rad;
  return safe_margin_rad(robot, joint, 0, kd) >= kLeastMargin &&
         (kp <= 0 || safe_margin_rad(robot, joint, kp, kd) >= kLeastMargin);
}

void settle_limits(Reader& in, RobotConfig& robot, JointConfig& joint) {
  const bool load = !std::isnan(joint.load_max_nm), inertia = !std::isnan(joint.inertia_max_kg_m2);
  if (std::isnan(joint.sim.inertia_kg_m2))  // what is simulated is the joint that the file describes
    joint.sim.inertia_kg_m2 = inertia ? joint.inertia_max_kg_m2 : PlantConfig{}.inertia_kg_m2;
  joint.inertia_declared = inertia;
  fill_in(robot, joint);
  check(in, joint, load);
  check_gain(in, "safe_kd_nm_s_rad", joint.safe_kd_nm_s_rad, "kd_max_nm_s_rad", joint.kd_max_nm_s_rad);
  check_gain(in, "safe_kp_nm_rad", joint.safe_kp_nm_rad, "kp_max_nm_rad", joint.kp_max_nm_rad);
  const bool reckoned = inertia || is_simulated(robot, joint);
  if (reckoned && joint.inertia_min_kg_m2 > 0 && joint.safe_kd_nm_s_rad > 0) check_safe_gains(in, robot, joint);
  if (closes_loop(robot.devices[joint.device])) return;  // its own loops move it: nothing here brakes it
  if ((!load || !inertia) && !is_simulated(robot, joint)) {
    robot.notes.push_back(fmt::format(
        "joint \"{}\" does not say {}: the guard reckons with load_max_nm = {:.3g} and inertia_max_kg_m2 = {:.3g}, and "
        "keeps it inside its limits only as far as that is true; measure and declare them (docs/hardware.md)",
        joint.name,
        !load && !inertia ? "load_max_nm and inertia_max_kg_m2" : (load ? "inertia_max_kg_m2" : "load_max_nm"),
        joint.load_max_nm, joint.inertia_max_kg_m2));
  }
  if (const std::string advice = way_advice(robot, joint); !advice.empty())
    robot.notes.push_back(fmt::format("joint \"{}\" {}", joint.name, advice));
  note_rate(robot, joint);
}

}  // namespace lithe::robot
