// SPDX-License-Identifier: Apache-2.0
#include "spine/robot/limits/model.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include "spine/robot/limits/drive_loop.hpp"

namespace lithe::robot {
namespace {

using mechanics::Square;

constexpr std::size_t kPoses = 200;

struct Pose {
  JointArray position_rad{}, gravity_nm{}, alone_kg_m2{};  // alone: felt by a motor when the other joints are free
  Square mass_kg_m2{};
};

// The middle of all ranges first, then any. False when the mass matrix is not positive definite.
bool evaluate(const RobotConfig& robot, std::vector<Pose>& poses) {
  mechanics::Tree tree = tree_of(robot);
  const std::size_t joints = tree.joints();
  std::mt19937_64 random(5);
  const auto unit = [&random] { return static_cast<double>(random() >> 11U) * 0x1p-53; };
  for (std::size_t i = 0; i < kPoses; ++i) {
    Pose& pose = poses.emplace_back();
    for (std::size_t j = 0; j < joints; ++j) {
      const JointConfig& joint = robot.joints[j];
      const double share = i == 0 ? 0.5 : unit();
      pose.position_rad[j] = joint.position_min_rad + share * (joint.position_max_rad - joint.position_min_rad);
    }
    Square lower{};
    tree.pose(pose.position_rad);
    tree.mass(pose.mass_kg_m2);
    tree.torque({}, {}, pose.gravity_nm);
    if (!mechanics::factor(joints, pose.mass_kg_m2, lower)) return false;
    for (std::size_t j = 0; j < joints; ++j) {
      JointArray one{};
      one[j] = 1;
      mechanics::solve(joints, lower, one);
      pose.alone_kg_m2[j] = 1 / one[j];
    }
  }
  return true;
}

double usable_nm(const RobotConfig& robot, std::size_t j) {
  return kUsableTorque * robot.joints[j].torque_max_nm / (1 + robot.model.error);
}

// Reports the first pose in which gravity takes all the torque that a brake may use.
bool gravity_leaves_torque(Reader& top, const RobotConfig& robot, const std::vector<Pose>& poses) {
  for (const Pose& pose : poses)
    for (std::size_t j = 0; j < robot.joints.size(); ++j) {
      if (std::abs(pose.gravity_nm[j]) < usable_nm(robot, j)) continue;
      const std::vector<double> at(pose.position_rad.begin(),
                                   pose.position_rad.begin() + static_cast<std::ptrdiff_t>(robot.joints.size()));
      top.complain(
          "model",
          fmt::format("at {:.2f} rad gravity pulls at joint \"{}\" with {:.3g} N m; of torque_max_nm = {:g} a "
                      "brake may use {:.3g} ([model] error = {:g}), so nothing is left to slow down with; give "
                      "it more torque_max_nm, less to carry, or limits without this pose",
                      fmt::join(at, ", "), robot.joints[j].name, std::abs(pose.gravity_nm[j]),
                      robot.joints[j].torque_max_nm, usable_nm(robot, j), robot.model.error));
      return false;
    }
  return true;
}

// The largest common scale of these decelerations for which all torques reach, whatever their signs.
double scale_of(const RobotConfig& robot, const std::vector<Pose>& poses, const JointArray& base_rad_s2) {
  double scale = 1e9;
  for (const Pose& pose : poses)
    for (std::size_t j = 0; j < robot.joints.size(); ++j) {
      double each_nm = 0;
      for (std::size_t k = 0; k < robot.joints.size(); ++k) each_nm += std::abs(pose.mass_kg_m2[j][k]) * base_rad_s2[k];
      scale = std::min(scale, (usable_nm(robot, j) - std::abs(pose.gravity_nm[j])) / each_nm);
    }
  return scale;
}

void allot(RobotConfig& robot, const std::vector<Pose>& poses) {
  constexpr double kCrossoverRadS = 250;  // that the drive's damping may have; its stiffness half of it
  JointArray base_rad_s2{};
  for (std::size_t j = 0; j < robot.joints.size(); ++j) {
    double most_kg_m2 = 0;
    for (const Pose& pose : poses) most_kg_m2 = std::max(most_kg_m2, pose.mass_kg_m2[j][j]);
    base_rad_s2[j] = robot.joints[j].torque_max_nm / std::sqrt(most_kg_m2);
  }
  const double scale = scale_of(robot, poses, base_rad_s2);
  for (std::size_t j = 0; j < robot.joints.size(); ++j) {
    JointModel& model = robot.joints[j].model;
    double alone_kg_m2 = poses.front().alone_kg_m2[j];
    for (const Pose& pose : poses) alone_kg_m2 = std::min(alone_kg_m2, pose.alone_kg_m2[j]);
    model.allotted_rad_s2 = scale * base_rad_s2[j];
    model.kd_most_nm_s_rad = kCrossoverRadS * alone_kg_m2;
    model.kp_most_nm_rad = 0.25 * kCrossoverRadS * kCrossoverRadS * alone_kg_m2;
  }
}

// What a drive does that the guard's model does not know; "" if nothing.
std::string why_not_together(const RobotConfig& robot, const JointConfig& joint) {
  const DeviceConfig& device = robot.devices[joint.device];
  if (loop_of(robot, joint) != DriveLoop::torque)
    return fmt::format(
        "device \"{}\" closes a velocity or position loop of its own, and the guard with a [model] bounds torques: "
        "give "
        "it mode = \"torque\", or remove [model] and every [joint.model]",
        device.name);
  // Which drive has its turn in which tick is known to the bus only.
  if (device.rate_divider != 1)
    return fmt::format(
        "device \"{}\" has rate_divider = {}, and with a [model] every drive must be asked in every tick: remove "
        "rate_divider and lower rate_hz until the bus has time for all drives, or remove [model] and every "
        "[joint.model]",
        device.name, device.rate_divider);
  return "";
}

}  // namespace

mechanics::Tree tree_of(const RobotConfig& robot) {
  mechanics::Tree tree;
  for (const JointConfig& joint : robot.joints) tree.add(joint.model.link);
  tree.set_gravity(robot.model.gravity_m_s2);
  return tree;
}

void settle_model(Reader& top, RobotConfig& robot) {
  for (const JointConfig& joint : robot.joints) {
    if (joint.model.given == robot.model.given) continue;
    return top.complain(
        "model",
        robot.model.given
            ? fmt::format("joint \"{}\" has no [joint.model]; the model is of all joints or of none", joint.name)
            : fmt::format("joint \"{}\" has a [joint.model], but there is no [model]; add it", joint.name));
  }
  if (!robot.model.given) return;
  for (const JointConfig& joint : robot.joints)
    if (const std::string why = why_not_together(robot, joint); !why.empty()) return top.complain("model", why);
  std::vector<Pose> poses;
  poses.reserve(kPoses);
  if (!evaluate(robot, poses))
    return top.complain("model",
                        "the links have no inertia about some joint; give the last links mass_kg off their "
                        "joint, inertia_kg_m2 or rotor_inertia_kg_m2");
  if (gravity_leaves_torque(top, robot, poses)) allot(robot, poses);
}

}  // namespace lithe::robot
