// SPDX-License-Identifier: Apache-2.0
#include "spine/robot/keys/sections.hpp"

#include <fmt/format.h>

#include <cmath>

namespace lithe::robot {
namespace {

constexpr double kLeastInertia = 1.0e-7;
constexpr double kDriveStepS = 5.0e-5;  // step of the simulated drives

void read_link(Reader& in, PlantConfig& sim) {
  in.number("length_m", sim.length_m, {0.0, 100.0});
  in.number("mass_kg", sim.mass_kg, {0.0, 1.0e4});
  in.number("center_m", sim.center_m, {-100.0, 100.0});
  in.number("link_inertia_kg_m2", sim.link_inertia_kg_m2, {0.0, 1.0e4});
  in.number("rotor_inertia_kg_m2", sim.rotor_inertia_kg_m2, {0.0, 1.0e4});
  for (const std::string_view key : {"inertia_kg_m2", "mgl_nm"})
    in.refuse(key, "in a chain the links make it: mass_kg, center_m, link_inertia_kg_m2, rotor_inertia_kg_m2");
}

void read_drive_errors(Reader& in, PlantConfig& sim) {
  constexpr double kLongestDelayS = 1.0e-3;
  in.number("torque_gain_error", sim.torque_gain_error, {0.0, 0.5});
  in.number("encoder_offset_rad", sim.encoder_offset_rad, {0.0, 1.0});
  in.number("torque_noise_nm", sim.torque_noise_nm, {0.0, kBig});
  in.number("encoder_noise_rad", sim.encoder_noise_rad, {0.0, 0.1});
  in.number("bus_delay_s", sim.bus_delay_s, {0.0, kLongestDelayS});
  in.integer("seed", sim.seed, {0, 9.0e15});
}

void refuse_link(Reader& in, std::string_view why) {
  for (const std::string_view key : {"length_m", "mass_kg", "center_m", "link_inertia_kg_m2", "rotor_inertia_kg_m2"})
    in.refuse(key, why);
}

}  // namespace

void read_mechanism(Reader& in, MechanismConfig& plant) {
  in.choice<PlantKind>(
      "kind", plant.kind,
      {{"independent", PlantKind::independent}, {"chain", PlantKind::chain}, {"mujoco", PlantKind::mujoco}});
  if (plant.kind == PlantKind::mujoco) {
    in.text("model", plant.model, Need::required);
    in.number("step_s", plant.step_s, {kDriveStepS, 2.0e-3});
    const double steps = plant.step_s / kDriveStepS;
    if (std::abs(steps - std::round(steps)) > 1e-6) {
      in.complain("step_s",
                  fmt::format("{} is no multiple of {}, in which the drives live", plant.step_s, kDriveStepS));
    }
    in.refuse("gravity_m_s2", "gravity is set in the model; remove this");
  } else {
    in.refuse("model", "is for kind = \"mujoco\" only");
    in.refuse("step_s", "is for kind = \"mujoco\" only");
    if (plant.kind == PlantKind::chain) in.number("gravity_m_s2", plant.gravity_m_s2, {-100.0, 100.0});
    if (plant.kind == PlantKind::independent)
      in.refuse("gravity_m_s2", "pulls at each joint's own mgl_nm; remove this");
  }
  in.boolean("ideal", plant.ideal);
  in.finish();
}

void forget_link(PlantConfig& sim) { sim.length_m = sim.mass_kg = sim.center_m = sim.link_inertia_kg_m2 = kUnsaid; }

void read_plant(Reader& in, PlantConfig& sim, PlantKind kind) {
  constexpr std::string_view kModelSays = "this is set in the model: armature, damping and frictionloss of its joint";
  if (kind == PlantKind::chain) {
    read_link(in, sim);
  } else if (kind == PlantKind::independent) {
    in.number("inertia_kg_m2", sim.inertia_kg_m2, {1.0e-7, 1.0e4});
    in.number("mgl_nm", sim.mgl_nm, {0.0, kBig});  // angle 0 hangs down; zero_rad describes another mounting
    refuse_link(in, "is for [plant] kind = \"chain\" only");
  } else {
    for (const std::string_view key : {"inertia_kg_m2", "mgl_nm"}) in.refuse(key, kModelSays);
    refuse_link(in, kModelSays);
  }
  if (kind == PlantKind::mujoco) {
    for (const std::string_view key : {"viscous_nm_s_rad", "coulomb_nm", "cogging_nm", "cogging_per_rev", "stribeck_nm",
                                       "stribeck_rad_s", "payload_kg", "payload_m"}) {
      in.refuse(key, kModelSays);
    }
  } else {
    in.number("viscous_nm_s_rad", sim.viscous_nm_s_rad, {0.0, kBig});
    in.number("coulomb_nm", sim.coulomb_nm, {0.0, kBig});
    in.number("cogging_nm", sim.cogging_nm, {0.0, kBig});
    in.integer("cogging_per_rev", sim.cogging_per_rev, {1, 10'000});
    in.number("stribeck_nm", sim.stribeck_nm, {0.0, kBig});
    in.number("stribeck_rad_s", sim.stribeck_rad_s, {1.0e-6, kBig});
    in.number("payload_kg", sim.payload_kg, {0.0, 1.0e4});
    in.number("payload_m", sim.payload_m, {0.0, 100.0});
  }
  read_drive_errors(in, sim);
  in.number("torque_lag_s", sim.torque_lag_s, {0.0, 1.0});
  in.integer("encoder_counts", sim.encoder_counts, {16, 16'777'216});
  in.number("initial_position_rad", sim.initial_position_rad, {-1.0e4, 1.0e4});
  in.finish();
}

void settle_link(Reader& joint, PlantConfig& sim) {
  if (std::isnan(sim.length_m) || std::isnan(sim.mass_kg)) {
    joint.complain("sim", fmt::format("a link of a chain needs {}; add it under [joint.sim]",
                                      std::isnan(sim.length_m) ? "length_m" : "mass_kg"));
    return;
  }
  if (std::isnan(sim.center_m)) sim.center_m = sim.length_m / 2;
  if (std::isnan(sim.link_inertia_kg_m2)) sim.link_inertia_kg_m2 = sim.mass_kg * sim.length_m * sim.length_m / 12;
  const double about_joint = sim.link_inertia_kg_m2 + sim.mass_kg * sim.center_m * sim.center_m;
  if (about_joint + sim.rotor_inertia_kg_m2 < kLeastInertia)
    joint.complain("sim", "the link has no inertia; give it some mass off its joint, or rotor_inertia_kg_m2");
}

}  // namespace lithe::robot
