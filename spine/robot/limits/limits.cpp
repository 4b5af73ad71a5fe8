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

void check(Reader& in, const JointConfig& joint, bool load_declared) {
  if (load_declared && joint.load_max_nm > kMostLoad * joint.torque_max_nm) {
    in.complain("load_max_nm",
                fmt::format("{} is more than {} of torque_max_nm = {}: what is left does not brake the "
                            "joint; give it a torque_max_nm of {:.3g}, or less to carry",
                            joint.load_max_nm, kMostLoad, joint.torque_max_nm, joint.load_max_nm / kMostLoad));
  }
  if (joint.inertia_min_kg_m2 > joint.inertia_max_kg_m2) {
    in.complain("inertia_min_kg_m2", fmt::format("{} is more than inertia_max_kg_m2 = {}; exchange or correct them",
                                                 joint.inertia_min_kg_m2, joint.inertia_max_kg_m2));
  }
}

// Left over of the phase margin, at the least inertia: 20 degrees.
constexpr double kLeastMargin = 0.35;

// Two digits, rounded down: what is advised must do.
double advised(double value) {
  const double digit = std::pow(10.0, std::floor(std::log10(std::max(value, 1e-12))) - 1);
  return std::floor(value / digit) * digit;
}

// The largest of a gain up to `most` that leaves the margin; the smaller, the more of it.
template <class Margin>
double largest(double most, Margin margin) {
  double good = 0;
  for (int i = 0; i < 40; ++i) {
    const double middle = 0.5 * (good + most);
    (margin(middle) >= kLeastMargin ? good : most) = middle;
  }
  return advised(good);
}

void check_gain(Reader& in, std::string_view key, double gain, std::string_view most_key, double most) {
  if (gain > most) {
    in.complain(key, fmt::format("{:g} is more than {} = {:g}, the most this drive may be given; lower it, or raise {}",
                                 gain, most_key, most, most_key));
  }
}

// The safe law must not shake the joint that it shall stop.
void check_safe_gains(Reader& in, const RobotConfig& robot, const JointConfig& joint) {
  const double delay_s = reaction_s(robot, joint) + 1 / robot.rate_hz + 0.5 * drive_period_s(robot, joint);
  const double inertia = joint.inertia_min_kg_m2, kd = joint.safe_kd_nm_s_rad, kp = joint.safe_kp_nm_rad;
  const auto margin = [&](double stiffness, double damping) {
    return phase_margin_rad(inertia, stiffness, damping, delay_s);
  };
  const std::string_view why =
      "shakes a joint of inertia_min_kg_m2 = {:g} whose torque comes {:.2g} s late; give at most {:.2g}";
  if (margin(0, kd) < kLeastMargin) {
    in.complain("safe_kd_nm_s_rad",
                fmt::format("{:g} {}", kd,
                            fmt::format(fmt::runtime(why), inertia, delay_s,
                                        largest(kd, [&](double each) { return margin(0, each); }))));
  } else if (kp > 0 && margin(kp, kd) < kLeastMargin) {
    in.complain("safe_kp_nm_rad", fmt::format("{:g} with safe_kd_nm_s_rad = {:g} {}", kp, kd,
                                              fmt::format(fmt::runtime(why), inertia, delay_s,
                                                          largest(kp, [&](double each) { return margin(each, kd); }))));
  }
}

// The fastest from which the joint stops within its whole range.
double fastest_rad_s(const RobotConfig& robot, const JointConfig& joint, double range_rad) {
  double slow = 0, fast = joint.velocity_max_rad_s;
  for (int i = 0; i < 40; ++i) {
    const double middle = 0.5 * (slow + fast);
    (stopping_way_rad(robot, joint, middle) <= range_rad ? slow : fast) = middle;
  }
  return slow;
}

void note_way(RobotConfig& robot, const JointConfig& joint) {
  const double range_rad = joint.position_max_rad - joint.position_min_rad;
  const double way_rad = stopping_way_rad(robot, joint, joint.velocity_max_rad_s);
  if (range_rad <= 0 || way_rad <= range_rad) return;
  robot.notes.push_back(fmt::format(
      "joint \"{}\" needs {:.2g} rad to stop from velocity_max_rad_s = {:g} and has {:.2g}: the guard keeps it slower; "
      "{:.2g} rad/s can be kept, or more torque_max_nm, less load_max_nm, less inertia_max_kg_m2",
      joint.name, way_rad, joint.velocity_max_rad_s, range_rad, fastest_rad_s(robot, joint, range_rad)));
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

void settle_limits(Reader& in, RobotConfig& robot, JointConfig& joint) {
  const bool load = !std::isnan(joint.load_max_nm), inertia = !std::isnan(joint.inertia_max_kg_m2);
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
  note_way(robot, joint);
  note_rate(robot, joint);
}

}  // namespace lithe::robot
