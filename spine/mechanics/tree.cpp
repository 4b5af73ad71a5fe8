// SPDX-License-Identifier: Apache-2.0
#include "spine/mechanics/tree.hpp"

#include <cmath>

namespace lithe::mechanics {

bool Tree::add(const Link& link) {
  if (count_ == kMaxJoints || (link.parent != Link::kBase && link.parent >= count_)) return false;
  link_[count_++] = link;
  return true;
}

void Tree::pose(const JointArray& position_rad) LITHE_RT {
  for (std::size_t j = 0; j < count_; ++j) {
    const Link& link = link_[j];
    Pose& pose = pose_[j];
    pose.turn = link.rest * rotation(link.axis, position_rad[j]);
    pose.way = pose.origin = link.offset_m;
    if (link.parent != Link::kBase) {
      const Pose& parent = pose_[link.parent];
      pose.turn = parent.turn * pose.turn;
      pose.way = parent.turn * link.offset_m;
      pose.origin = parent.origin + pose.way;
    }
    pose.axis = pose.turn * link.axis;
    pose.center = pose.turn * link.center_m;
    pose.inertia = pose.turn * link.inertia_kg_m2 * pose.turn.transposed();
  }
}

void Tree::mass(Square& mass_kg_m2) LITHE_RT {
  for (std::size_t j = 0; j < count_; ++j) {
    const double mass = link_[j].mass_kg;
    const Vector center = pose_[j].origin + pose_[j].center;
    body_[j] = {mass, mass * center, pose_[j].inertia + inertia_of(mass, center)};
    for (std::size_t i = 0; i < count_; ++i) mass_kg_m2[j][i] = 0;
  }
  for (std::size_t j = count_; j-- > 0;) {
    const Vector& axis = pose_[j].axis;
    const Body& body = body_[j];
    // Momentum of the body, about the base's origin, when hinge j turns with 1 rad/s.
    const Vector linear = cross(axis, body.moment_kg_m - body.mass_kg * pose_[j].origin);
    const Vector angular = body.inertia * axis - cross(body.moment_kg_m, cross(axis, pose_[j].origin));
    for (std::size_t i = j; i != Link::kBase; i = link_[i].parent)
      mass_kg_m2[i][j] = mass_kg_m2[j][i] = dot(pose_[i].axis, angular - cross(pose_[i].origin, linear));
    mass_kg_m2[j][j] += link_[j].rotor_kg_m2;
    if (link_[j].parent == Link::kBase) continue;
    Body& parent = body_[link_[j].parent];
    parent.mass_kg += body.mass_kg;
    parent.moment_kg_m = parent.moment_kg_m + body.moment_kg_m;
    parent.inertia = parent.inertia + body.inertia;
  }
}

void Tree::torque(const JointArray& velocity_rad_s, const JointArray& acceleration_rad_s2, JointArray& torque_nm)
    LITHE_RT {
  // A base that accelerates upwards acts as gravity does.
  const Motion base{.origin_m_s2 = -1.0 * gravity_m_s2_};
  for (std::size_t j = 0; j < count_; ++j) {
    const Link& link = link_[j];
    const Pose& pose = pose_[j];
    const Motion& parent = link.parent == Link::kBase ? base : motion_[link.parent];
    Motion& motion = motion_[j];
    const Vector own = velocity_rad_s[j] * pose.axis;
    motion.turn_rad_s = parent.turn_rad_s + own;
    motion.turn_rad_s2 = parent.turn_rad_s2 + cross(parent.turn_rad_s, own) + acceleration_rad_s2[j] * pose.axis;
    motion.origin_m_s2 = parent.origin_m_s2 + cross(parent.turn_rad_s2, pose.way) +
                         cross(parent.turn_rad_s, cross(parent.turn_rad_s, pose.way));
    const Vector center_m_s2 = motion.origin_m_s2 + cross(motion.turn_rad_s2, pose.center) +
                               cross(motion.turn_rad_s, cross(motion.turn_rad_s, pose.center));
    motion.force_n = link.mass_kg * center_m_s2;
    motion.moment_nm = pose.inertia * motion.turn_rad_s2 + cross(motion.turn_rad_s, pose.inertia * motion.turn_rad_s) +
                       cross(pose.center, motion.force_n);
  }
  for (std::size_t j = count_; j-- > 0;) {
    const Link& link = link_[j];
    const Motion& motion = motion_[j];
    torque_nm[j] = dot(pose_[j].axis, motion.moment_nm) + link.viscous_nm_s_rad * velocity_rad_s[j] +
                   link.rotor_kg_m2 * acceleration_rad_s2[j];
    if (link.parent == Link::kBase) continue;
    Motion& parent = motion_[link.parent];
    parent.force_n = parent.force_n + motion.force_n;
    parent.moment_nm = parent.moment_nm + motion.moment_nm + cross(pose_[j].way, motion.force_n);
  }
}

bool factor(std::size_t joints, const Square& matrix, Square& lower) LITHE_RT {
  for (std::size_t j = 0; j < joints; ++j) {
    double square = matrix[j][j];
    for (std::size_t k = 0; k < j; ++k) square -= lower[j][k] * lower[j][k];
    if (!(square > 0)) return false;
    lower[j][j] = std::sqrt(square);
    for (std::size_t i = j + 1; i < joints; ++i) {
      double rest = matrix[i][j];
      for (std::size_t k = 0; k < j; ++k) rest -= lower[i][k] * lower[j][k];
      lower[i][j] = rest / lower[j][j];
    }
  }
  return true;
}

void solve(std::size_t joints, const Square& lower, JointArray& x) LITHE_RT {
  for (std::size_t i = 0; i < joints; ++i) {
    for (std::size_t k = 0; k < i; ++k) x[i] -= lower[i][k] * x[k];
    x[i] /= lower[i][i];
  }
  for (std::size_t i = joints; i-- > 0;) {
    for (std::size_t k = i + 1; k < joints; ++k) x[i] -= lower[k][i] * x[k];
    x[i] /= lower[i][i];
  }
}

}  // namespace lithe::mechanics
