// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/physics/chain.hpp"

#include <algorithm>
#include <cmath>

namespace lithe::hal::sim {

Chain::Chain(const ChainParams& params)
    : gravity_m_s2_(params.gravity_m_s2), count_(std::min(params.links.size(), kMaxJoints)) {
  for (std::size_t i = 0; i < count_; ++i) {
    Joint& joint = joints_[i];
    joint.link = params.links[i];
    joint.first_moment_kg_m = joint.link.mass_kg * joint.link.center_m;
    joint.inertia_kg_m2 = joint.link.inertia_kg_m2 + joint.first_moment_kg_m * joint.link.center_m;
    joint.phase_rad = cogging_phase_rad(joint.link.joint.seed);
    joint.lag_gain = Plant::lag_gain(joint.link.joint.torque_lag_s);
    joint.position_rad = joint.link.joint.initial_position_rad;
  }
}

double Chain::inertia_kg_m2(std::size_t joint) const {
  double sum = joints_[joint].link.rotor_inertia_kg_m2;
  double way_m = 0;
  for (std::size_t i = joint; i < count_; ++i) {
    const Joint& each = joints_[i];
    sum += each.inertia_kg_m2 + way_m * (2 * each.first_moment_kg_m + each.link.mass_kg * way_m);
    way_m += each.link.length_m;
  }
  return sum;
}

void Chain::place(std::size_t joint, double position_rad, double velocity_rad_s) LITHE_RT {
  joints_[joint].position_rad = position_rad;
  joints_[joint].velocity_rad_s = velocity_rad_s;
  for (Joint& each : joints_) each.acceleration_rad_s2 = 0;
}

void Chain::to_start() LITHE_RT {
  for (Joint& joint : joints_) {
    joint.position_rad = joint.link.joint.initial_position_rad;
    joint.velocity_rad_s = joint.torque_nm = joint.acceleration_rad_s2 = 0;
  }
}

void Chain::step(std::span<const double> wanted_nm) LITHE_RT {
  drive(wanted_nm);
  place_links();
  // Each pass frees at least one joint, so there are no more passes than joints; nearly always there is one.
  do {
    accelerate();
  } while (unlock());
  move();
}

// Torques at the joints, without the coupling between links.
void Chain::drive(std::span<const double> wanted_nm) LITHE_RT {
  for (std::size_t i = 0; i < count_; ++i) {
    Joint& joint = joints_[i];
    const PlantParams& is = joint.link.joint;
    const double wanted = i < wanted_nm.size() ? wanted_nm[i] : 0;
    joint.torque_nm = Plant::lagged_nm(joint.torque_nm, wanted, is.torque_max_nm, joint.lag_gain);
    joint.driving_nm = joint.torque_nm - is.viscous_nm_s_rad * joint.velocity_rad_s;
    if (is.cogging_nm != 0)
      joint.driving_nm -= is.cogging_nm * std::sin(is.cogging_per_rev * joint.position_rad + joint.phase_rad);
    joint.dry_nm = dry_friction_nm(is.coulomb_nm, is.stribeck_nm, is.stribeck_rad_s, joint.velocity_rad_s);
    joint.locked = joint.velocity_rad_s == 0 && joint.dry_nm > 0;
    joint.friction_nm = joint.velocity_rad_s != 0 ? -std::copysign(joint.dry_nm, joint.velocity_rad_s) : 0;
  }
}

// Absolute position and velocity of every link.
void Chain::place_links() LITHE_RT {
  double angle_rad = 0;
  double turn_rad_s = 0;
  for (std::size_t i = 0; i < count_; ++i) {
    Joint& joint = joints_[i];
    angle_rad += joint.position_rad;
    // The velocity half a step ahead, with the acceleration of the last step (second-order accurate).
    turn_rad_s += joint.velocity_rad_s + 0.5 * Plant::kStepS * joint.acceleration_rad_s2;
    const double sine = std::sin(angle_rad);
    const double cosine = std::cos(angle_rad);
    joint.moment_x = joint.first_moment_kg_m * sine;
    joint.moment_y = -joint.first_moment_kg_m * cosine;
    joint.next_x = joint.link.length_m * sine;
    joint.next_y = -joint.link.length_m * cosine;
    joint.turn2 = turn_rad_s * turn_rad_s;
  }
}

// Articulated-body algorithm: inertias from the tip inwards, then accelerations from the base outwards.
void Chain::accelerate() LITHE_RT {
  for (std::size_t i = count_; i-- > 0;) {
    Joint& joint = joints_[i];
    joint.body = {joint.inertia_kg_m2, -joint.moment_y, joint.moment_x, joint.link.mass_kg, 0, joint.link.mass_kg};
    joint.pull = {0, -joint.turn2 * joint.moment_x, -joint.turn2 * joint.moment_y};
    if (i + 1 < count_) hang_on(joint, joints_[i + 1]);
    // Viscous friction is implicit (velocity at the end of the step), so it acts like an inertia and is stable for any
    // size.
    joint.resistance =
        joint.body.rr + joint.link.rotor_inertia_kg_m2 + Plant::kStepS * joint.link.joint.viscous_nm_s_rad;
  }
  Motion base{0, 0, gravity_m_s2_};  // gravity is a base that accelerates upwards
  for (std::size_t i = 0; i < count_; ++i) {
    Joint& joint = joints_[i];
    const Inertia& body = joint.body;
    const double needed_nm = body.rr * base.r + body.rx * base.x + body.ry * base.y + joint.pull.r;
    joint.holding_nm = needed_nm - joint.driving_nm;
    joint.acceleration_rad_s2 =
        joint.locked ? 0 : (joint.driving_nm + joint.friction_nm - needed_nm) / joint.resistance;
    base.r += joint.acceleration_rad_s2;
    base.x -= base.r * joint.next_y + joint.turn2 * joint.next_x;
    base.y += base.r * joint.next_x - joint.turn2 * joint.next_y;
  }
}

// Adds to `joint` the inertia and force of everything outside: all of it when `outer` is locked, otherwise without the
// part along the axis of `outer`.
void Chain::hang_on(Joint& joint, const Joint& outer) LITHE_RT {
  Inertia felt = outer.body;
  Motion pull = outer.pull;
  if (!outer.locked) {
    const double r = outer.body.rr / outer.resistance;
    const double x = outer.body.rx / outer.resistance;
    const double y = outer.body.ry / outer.resistance;
    felt.rr -= outer.body.rr * r;
    felt.rx -= outer.body.rr * x;
    felt.ry -= outer.body.rr * y;
    felt.xx -= outer.body.rx * x;
    felt.xy -= outer.body.rx * y;
    felt.yy -= outer.body.ry * y;
    const double free_nm = outer.driving_nm + outer.friction_nm - outer.pull.r;
    pull.r += r * free_nm;
    pull.x += x * free_nm;
    pull.y += y * free_nm;
  }
  const double dx = joint.next_x;
  const double dy = joint.next_y;
  const double bias_x = -joint.turn2 * dx;
  const double bias_y = -joint.turn2 * dy;
  pull.r += felt.rx * bias_x + felt.ry * bias_y;
  pull.x += felt.xx * bias_x + felt.xy * bias_y;
  pull.y += felt.xy * bias_x + felt.yy * bias_y;
  const double rx = felt.rx - dy * felt.xx + dx * felt.xy;  // relative to the inner joint
  const double ry = felt.ry - dy * felt.xy + dx * felt.yy;
  joint.body.rr += felt.rr - dy * (felt.rx + rx) + dx * (felt.ry + ry);
  joint.body.rx += rx;
  joint.body.ry += ry;
  joint.body.xx += felt.xx;
  joint.body.xy += felt.xy;
  joint.body.yy += felt.yy;
  joint.pull.r += pull.r - dy * pull.x + dx * pull.y;
  joint.pull.x += pull.x;
  joint.pull.y += pull.y;
}

// Frees every joint that its dry friction cannot hold. False: there was none.
bool Chain::unlock() LITHE_RT {
  bool freed = false;
  for (std::size_t i = 0; i < count_; ++i) {
    Joint& joint = joints_[i];
    if (!joint.locked || std::abs(joint.holding_nm) <= joint.dry_nm) continue;
    joint.locked = false;
    joint.friction_nm = std::copysign(joint.dry_nm, joint.holding_nm);
    freed = true;
  }
  return freed;
}

void Chain::move() LITHE_RT {
  for (std::size_t i = 0; i < count_; ++i) {
    Joint& joint = joints_[i];
    const double before_rad_s = joint.velocity_rad_s;
    joint.velocity_rad_s += Plant::kStepS * joint.acceleration_rad_s2;
    // Friction only stops a joint: it never reverses it or starts it from rest.
    const double pushed_rad_s = before_rad_s != 0 ? before_rad_s : -joint.friction_nm;
    if (joint.dry_nm > 0 && pushed_rad_s * joint.velocity_rad_s < 0) {
      joint.velocity_rad_s = 0;
      joint.acceleration_rad_s2 = 0;
    }
    joint.position_rad += Plant::kStepS * joint.velocity_rad_s;
  }
}

}  // namespace lithe::hal::sim
