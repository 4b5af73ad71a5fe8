// SPDX-License-Identifier: Apache-2.0
// Physics of a chain of links in one plane.
#pragma once

#include <array>
#include <cstddef>
#include <span>
#include <vector>

#include "spine/core/joints.hpp"
#include "spine/core/rt.hpp"
#include "spine/hal/physics/plant.hpp"

namespace lithe::hal::sim {

struct ChainLink {
  double length_m = 0.3;  // from its joint to the next one
  double mass_kg = 0.2;
  double center_m = 0.15;             // from its joint to its centre of mass, on the line to the next joint
  double inertia_kg_m2 = 1.5e-3;      // about its centre of mass
  double rotor_inertia_kg_m2 = 2e-3;  // of the motor, behind its gear; may be 0
  // Friction, cogging, lag, limit and start of the joint. Its inertia and mgl are not used: they follow from the links.
  PlantParams joint;
};

struct ChainParams {
  double gravity_m_s2 = 9.81;
  std::vector<ChainLink> links;  // from the base outwards; 1 to kMaxJoints
};

// Angles are those between links, the first one's from straight down; all 0: the chain hangs. Torque at a joint acts
// between its two links. Motor and friction of each joint are Plant's, and a chain of one link moves as a Plant does.
//
// Articulated bodies (Featherstone), in the plane: a step costs O(links). Semi-implicit Euler in steps of
// Plant::kStepNs; terms that depend on the velocity use the velocity in the middle of the step, so that the integration
// neither adds nor removes energy. A joint at rest stays locked until the torque needed to hold it exceeds its dry
// friction; a joint that would reverse within a step stops. Same inputs, same motion, to the bit.
// Contract: RT · one thread · no clock of its own
class Chain final : public Mechanism {
 public:
  // Contract: never in the tick. Masses and lengths are positive or 0, and every link has some inertia.
  explicit Chain(const ChainParams& params);

  void step(std::span<const double> wanted_nm) LITHE_RT override;
  void to_start() LITHE_RT override;

  std::size_t joints() const LITHE_RT override { return count_; }
  double position_rad(std::size_t joint) const LITHE_RT override { return joints_[joint].position_rad; }
  double velocity_rad_s(std::size_t joint) const LITHE_RT override { return joints_[joint].velocity_rad_s; }
  double torque_nm(std::size_t joint) const LITHE_RT override { return joints_[joint].torque_nm; }

  double inertia_kg_m2(std::size_t joint) const override;  // stretched

  // Sets position and velocity of a joint.
  // Contract: tests and set-up
  void place(std::size_t joint, double position_rad, double velocity_rad_s = 0) LITHE_RT;

 private:
  // Articulated-body inertia, symmetric, over (rotation, x, y), in non-rotating axes.
  struct Inertia {
    double rr = 0, rx = 0, ry = 0, xx = 0, xy = 0, yy = 0;
  };
  struct Motion {  // or a force: torque, force along x and y
    double r = 0, x = 0, y = 0;
  };
  struct Joint {
    ChainLink link;
    // Constants.
    double first_moment_kg_m = 0, inertia_kg_m2 = 0;  // of the link about its joint
    double phase_rad = 0, lag_gain = 1;
    // State.
    double position_rad = 0, velocity_rad_s = 0, torque_nm = 0, acceleration_rad_s2 = 0;
    // Values of the present step.
    double driving_nm = 0, dry_nm = 0, friction_nm = 0, holding_nm = 0;
    bool locked = false;
    double moment_x = 0, moment_y = 0, next_x = 0, next_y = 0;  // first moment; way to the next joint
    double turn2 = 0;                                           // squared absolute angular velocity of the link
    Inertia body;                                               // of the link and everything outside it
    Motion pull;                                                // bias force of the body
    double resistance = 0;
  };

  void drive(std::span<const double> wanted_nm) LITHE_RT;
  void place_links() LITHE_RT;
  void accelerate() LITHE_RT;
  bool unlock() LITHE_RT;
  void move() LITHE_RT;
  static void hang_on(Joint& joint, const Joint& outer) LITHE_RT;

  double gravity_m_s2_;
  std::size_t count_;
  std::array<Joint, kMaxJoints> joints_{};
};

}  // namespace lithe::hal::sim
