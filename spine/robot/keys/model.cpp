// SPDX-License-Identifier: Apache-2.0
// [model] and each joint's `model`: what the guard knows of the robot's links. Never its simulation.
#include <fmt/format.h>

#include <array>
#include <cmath>

#include "spine/robot/keys/sections.hpp"

namespace lithe::robot {
namespace {

using mechanics::Matrix;
using mechanics::Vector;

void read_vector(Reader& in, std::string_view key, Vector& out, Range range) {
  std::array<double, 3> values{out.x, out.y, out.z};
  in.numbers(key, values, range);
  out = {values[0], values[1], values[2]};
}

void read_axis(Reader& in, Vector& axis) {
  Vector read = axis;
  read_vector(in, "axis", read, {-kBig, kBig});
  const double size = std::sqrt(dot(read, read));
  if (size < 1e-6) return in.complain("axis", "has no direction; give the joint's axis, [0, 0, 1] is z");
  axis = 1 / size * read;
}

// Roll, pitch and yaw about the parent's axes, as in a URDF.
void read_rest(Reader& in, Matrix& rest) {
  constexpr double kTurn = 6.3;
  Vector angles;
  read_vector(in, "rest_rad", angles, {-kTurn, kTurn});
  rest = mechanics::rotation({0, 0, 1}, angles.z) * mechanics::rotation({0, 1, 0}, angles.y) *
         mechanics::rotation({1, 0, 0}, angles.x);
}

void read_inertia(Reader& in, Matrix& inertia) {
  std::array<double, 6> six{};  // xx, yy, zz, xy, xz, yz
  in.numbers("inertia_kg_m2", six, {-1.0e4, 1.0e4});
  const auto [xx, yy, zz, xy, xz, yz] = six;
  inertia = {{xx, xy, xz}, {xy, yy, yz}, {xz, yz, zz}};
  if (xx < 0 || yy < 0 || zz < 0 || xx + yy < zz || yy + zz < xx || zz + xx < yy)
    in.complain("inertia_kg_m2", "is of no body: of xx, yy, zz none may be below 0 or above the sum of the others");
}

}  // namespace

void read_model(Reader& in, ModelConfig& model) {
  model.given = true;
  read_vector(in, "gravity_m_s2", model.gravity_m_s2, {-100.0, 100.0});
  in.number("error", model.error, {0.05, 2.0});
  in.finish();
}

void read_joint_model(Reader& in, const RobotConfig& robot, JointModel& model) {
  mechanics::Link& link = model.link;
  const std::size_t own = robot.joints.size() - 1;  // the joint that is being read is the last
  model.given = true;
  link.parent = own == 0 ? mechanics::Link::kBase : own - 1;
  std::string parent;
  in.text("parent", parent);
  if (!parent.empty()) {
    link.parent = mechanics::Link::kBase;
    for (std::size_t j = 0; j < own; ++j)
      if (robot.joints[j].name == parent) link.parent = j;
    if (link.parent == mechanics::Link::kBase && parent != "base")
      in.complain("parent", fmt::format("\"{}\" is no [[joint]] above this one; name one, or \"base\"", parent));
  }
  read_axis(in, link.axis);
  read_vector(in, "offset_m", link.offset_m, {-100.0, 100.0});
  read_rest(in, link.rest);
  in.number("mass_kg", link.mass_kg, {0.0, 1.0e4}, Need::required);
  read_vector(in, "center_m", link.center_m, {-100.0, 100.0});
  read_inertia(in, link.inertia_kg_m2);
  in.number("rotor_inertia_kg_m2", link.rotor_kg_m2, {0.0, 1.0e4});
  in.number("viscous_nm_s_rad", link.viscous_nm_s_rad, {0.0, kBig});
  in.number("coulomb_nm", model.coulomb_nm, {0.0, kBig});
  in.number("torque_lag_s", model.torque_lag_s, {0.0, 0.05});
  in.number("velocity_filter_rad_s", model.velocity_filter_rad_s, {10.0, kBig});
  in.finish();
}

}  // namespace lithe::robot
