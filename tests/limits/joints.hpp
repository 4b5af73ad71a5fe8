// SPDX-License-Identifier: Apache-2.0
// The joints of a robot under test: each on its own, as a chain, or by MuJoCo.
#pragma once

#include <cmath>
#include <cstdio>
#include <memory>
#include <random>
#include <span>
#include <utility>
#include <vector>

#include "spine/hal/physics/chain.hpp"
#include "spine/hal/physics/mujoco_plant.hpp"
#include "spine/hal/physics/plant.hpp"
#include "tests/limits/rig.hpp"

namespace lithe::limits {

class Joints {
 public:
  explicit Joints(const Run& run) {
    const robot::RobotConfig& robot = run.robot;
    std::mt19937_64 dice(run.seed + 99);
    const auto within = [&](double share) { return 1 + std::uniform_real_distribution<double>(-share, share)(dice); };
    const double payload_kg = run.payload_kg * std::uniform_real_distribution<double>(0, 1)(dice);
    hal::sim::ChainParams chain;
    chain.gravity_m_s2 = robot.plant.gravity_m_s2;
    for (const robot::JointConfig& joint : robot.joints) {
      const robot::PlantConfig& sim = joint.sim;
      const hal::sim::PlantParams plant{.inertia_kg_m2 = sim.inertia_kg_m2,
                                        .mgl_nm = sim.mgl_nm,
                                        .viscous_nm_s_rad = sim.viscous_nm_s_rad,
                                        .coulomb_nm = sim.coulomb_nm,
                                        .cogging_nm = sim.cogging_nm,
                                        .cogging_per_rev = sim.cogging_per_rev,
                                        .torque_lag_s = sim.torque_lag_s,
                                        .initial_position_rad = sim.initial_position_rad,
                                        .seed = sim.seed};
      chain.links.push_back(
          {sim.length_m, sim.mass_kg, sim.center_m, sim.link_inertia_kg_m2, sim.rotor_inertia_kg_m2, plant});
      hal::sim::ChainLink& link = chain.links.back();
      const double mass = within(run.model_error);
      link.mass_kg *= mass;
      link.inertia_kg_m2 *= mass;
      link.rotor_inertia_kg_m2 *= within(run.model_error);
      link.center_m *= within(0.4 * run.model_error);
      if (payload_kg > 0 && &joint == &robot.joints.back()) add_at_tip(link, payload_kg);
      plants_.emplace_back(plant);
    }
    if (robot.plant.kind == robot::PlantKind::chain) together_ = std::make_unique<hal::sim::Chain>(chain);
    if (robot.plant.kind == robot::PlantKind::mujoco) together_ = by_mujoco(robot);
  }

  static std::unique_ptr<hal::sim::Mechanism> by_mujoco(const robot::RobotConfig& robot) {
    hal::sim::MujocoParams arm{
        .model = robot.plant.model, .step_ns = std::llround(robot.plant.step_s * 1e9), .joints = {}};
    for (const robot::JointConfig& joint : robot.joints) {
      arm.joints.push_back({.name = joint.name,
                            .initial_position_rad = joint.sim.initial_position_rad,
                            .torque_lag_s = joint.sim.torque_lag_s,
                            .torque_max_nm = joint.torque_max_nm,
                            .position_min_rad = joint.position_min_rad,
                            .position_max_rad = joint.position_max_rad});
    }
    Result<std::unique_ptr<hal::sim::Mechanism>> made =
        open_mujoco(arm, []() -> std::int64_t { return 0; });  // however slow this machine is
    if (!made) std::fprintf(stderr, "%s\n", made.message().c_str());
    return made ? std::move(*made) : nullptr;
  }

  static void add_at_tip(hal::sim::ChainLink& link, double mass_kg) {
    const double whole = link.mass_kg + mass_kg;
    const double center = (link.mass_kg * link.center_m + mass_kg * link.length_m) / whole;
    const double moved = center - link.center_m, away = link.length_m - center;
    link.inertia_kg_m2 += link.mass_kg * moved * moved + mass_kg * away * away;
    link.center_m = center;
    link.mass_kg = whole;
  }

  void step(std::span<const double> torque_nm) {
    if (together_ != nullptr) return together_->step(torque_nm);
    for (std::size_t j = 0; j < plants_.size(); ++j) plants_[j].step(torque_nm[j]);
  }
  double position_rad(std::size_t j) const {
    return together_ != nullptr ? together_->position_rad(j) : plants_[j].position_rad();
  }
  double velocity_rad_s(std::size_t j) const {
    return together_ != nullptr ? together_->velocity_rad_s(j) : plants_[j].velocity_rad_s();
  }

 private:
  std::vector<hal::sim::Plant> plants_;
  std::unique_ptr<hal::sim::Mechanism> together_;
};

}  // namespace lithe::limits
