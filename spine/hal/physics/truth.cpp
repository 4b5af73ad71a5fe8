// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/physics/truth.hpp"

#include <cmath>

#include "spine/hal/physics/plant.hpp"

namespace lithe::hal::sim {
namespace {

constexpr double kGravity = 9.81;  // m/s^2, as in a chain where the file says nothing else

// A point mass, `arm_m` from the joint.
void hang_on_joint(robot::PlantConfig& plant, double mass_kg) {
  plant.inertia_kg_m2 += mass_kg * plant.payload_m * plant.payload_m;
  plant.mgl_nm += mass_kg * kGravity * plant.payload_m;
}

// Adds a point mass to a link: new mass, centre, and inertia about the new centre.
void hang_on_link(robot::PlantConfig& plant, double mass_kg) {
  const double whole_kg = plant.mass_kg + mass_kg;
  if (!(whole_kg > 0)) return;
  const double center_m = (plant.mass_kg * plant.center_m + mass_kg * plant.payload_m) / whole_kg;
  const double link_m = center_m - plant.center_m, payload_m = plant.payload_m - center_m;
  plant.link_inertia_kg_m2 += plant.mass_kg * link_m * link_m + mass_kg * payload_m * payload_m;
  plant.center_m = center_m;
  plant.mass_kg = whole_kg;
}

// Joints of one file differ although they have the same seed.
std::uint64_t seed_of(const robot::JointConfig& joint) {
  std::uint64_t seed = joint.sim.seed;
  for (const char letter : joint.name) seed = Draws(seed ^ static_cast<unsigned char>(letter)).next();
  return seed;
}

}  // namespace

Truth draw_truth(const robot::RobotConfig& config, const robot::JointConfig& joint) {
  Truth truth;
  truth.plant = joint.sim;
  robot::PlantConfig& plant = truth.plant;
  if (config.plant.ideal) {
    plant.cogging_nm = plant.stribeck_nm = 0;
  } else {
    Draws draws(seed_of(joint));
    truth.drive.torque_gain = plant.torque_gain_error * draws.signed_share();
    truth.drive.encoder_offset_rad = plant.encoder_offset_rad * draws.signed_share();
    truth.payload_kg = plant.payload_kg * draws.share();
    truth.drive.seed = draws.next();
    truth.drive.torque_noise_nm = plant.torque_noise_nm;
    truth.drive.encoder_noise_rad = plant.encoder_noise_rad;
    truth.drive.delay_ns = std::llround(1e9 * plant.bus_delay_s / static_cast<double>(Plant::kStepNs)) * Plant::kStepNs;
    config.plant.kind == robot::PlantKind::chain ? hang_on_link(plant, truth.payload_kg)
                                                 : hang_on_joint(plant, truth.payload_kg);
  }
  truth.mgl_told_nm = plant.mgl_nm / (1 + truth.drive.torque_gain);
  return truth;
}

}  // namespace lithe::hal::sim
