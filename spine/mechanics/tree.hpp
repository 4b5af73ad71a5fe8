// SPDX-License-Identifier: Apache-2.0
// Dynamics of rigid links that hinges join to a tree with a fixed base.
#pragma once

#include <array>
#include <cstddef>

#include "spine/core/joints.hpp"
#include "spine/core/rt.hpp"
#include "spine/mechanics/vector.hpp"

namespace lithe::mechanics {

// A link and the hinge that joins it to its parent. The link's frame has its origin on the hinge and turns with the
// link.
struct Link {
  static constexpr std::size_t kBase = kMaxJoints;

  std::size_t parent = kBase;   // index of an earlier link
  Vector axis{0, 0, 1};         // of the hinge, a unit vector, in the link's frame
  Vector offset_m{};            // of the hinge from the parent's origin, in the parent's frame
  Matrix rest = kIdentity;      // from the link's frame to the parent's at angle 0
  double mass_kg = 0;           // finite, 0 or more
  Vector center_m{};            // centre of mass, in the link's frame
  Matrix inertia_kg_m2{};       // about the centre of mass, in the link's frame; symmetric
  double rotor_kg_m2 = 0;       // of the motor, behind its gear; it acts on this hinge only
  double viscous_nm_s_rad = 0;  // friction of the hinge
};

using Square = std::array<JointArray, kMaxJoints>;  // the first `joints` rows and columns are used

// Composite rigid bodies and recursive Newton-Euler (Featherstone, Rigid Body Dynamics Algorithms), all in the frame of
// the base.
// Contract: RT after add() · one thread · bounded work: O(joints^2) for mass(), O(joints) for the others
class Tree {
 public:
  // Contract: never in the tick. False, and nothing is added, when it is full or the parent is no earlier link.
  bool add(const Link& link);
  void set_gravity(const Vector& gravity_m_s2) LITHE_RT { gravity_m_s2_ = gravity_m_s2; }  // in the base's frame

  std::size_t joints() const LITHE_RT { return count_; }

  // What mass() and torque() use, until the next pose [rad].
  void pose(const JointArray& position_rad) LITHE_RT;

  // [kg m^2]. Symmetric.
  void mass(Square& mass_kg_m2) LITHE_RT;

  // That moves the joints with these velocities [rad/s] and accelerations [rad/s^2], against gravity and viscous
  // friction [N m]. With accelerations of 0 it is the bias.
  void torque(const JointArray& velocity_rad_s, const JointArray& acceleration_rad_s2, JointArray& torque_nm) LITHE_RT;

 private:
  struct Pose {  // in the base's frame
    Matrix turn;
    Vector origin, axis, way, center;  // way: from the parent's origin; center: from this origin
    Matrix inertia;                    // about the centre of mass
  };
  struct Motion {
    Vector turn_rad_s{}, turn_rad_s2{}, origin_m_s2{}, force_n{}, moment_nm{};  // moment about the origin
  };
  struct Body {  // a link and all that hangs on it; about the base's origin
    double mass_kg = 0;
    Vector moment_kg_m{};
    Matrix inertia{};
  };

  std::size_t count_ = 0;
  Vector gravity_m_s2_{};
  std::array<Link, kMaxJoints> link_{};
  std::array<Pose, kMaxJoints> pose_{};
  std::array<Motion, kMaxJoints> motion_{};
  std::array<Body, kMaxJoints> body_{};
};

// The lower triangle L of a symmetric positive definite matrix L L^T. False when it is not positive definite.
bool factor(std::size_t joints, const Square& matrix, Square& lower) LITHE_RT;
// Solves L L^T x = b in place.
void solve(std::size_t joints, const Square& lower, JointArray& x) LITHE_RT;

}  // namespace lithe::mechanics
