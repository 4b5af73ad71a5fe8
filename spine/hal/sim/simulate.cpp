// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/sim/simulate.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <utility>

#include "spine/hal/physics/chain.hpp"
#include "spine/hal/physics/mujoco_plant.hpp"
#include "spine/hal/physics/truth.hpp"

namespace lithe::hal::sim {
namespace {

using robot::PlantKind;

// Without a motor: no limit.
double motor_torque_max_nm(const robot::DeviceConfig& device) {
  const auto& type = type_of(device.kind);
  return type.motor_torque_max_nm != nullptr ? type.motor_torque_max_nm(device) : PlantParams{}.torque_max_nm;
}

PlantParams plant_of(const robot::RobotConfig& config, const robot::JointConfig& joint, const Truth& truth) {
  const robot::PlantConfig& sim = truth.plant;
  return {sim.inertia_kg_m2,        sim.mgl_nm,
          sim.viscous_nm_s_rad,     sim.coulomb_nm,
          sim.cogging_nm,           sim.cogging_per_rev,
          sim.stribeck_nm,          sim.stribeck_rad_s,
          sim.torque_lag_s,         motor_torque_max_nm(config.devices[joint.device]) * joint.ratio,
          sim.initial_position_rad, sim.seed};
}

std::unique_ptr<Mechanism> make_chain(const robot::RobotConfig& config) {
  ChainParams params;
  params.gravity_m_s2 = config.plant.gravity_m_s2;
  for (const robot::JointConfig& joint : config.joints) {
    const Truth truth = draw_truth(config, joint);
    const robot::PlantConfig& sim = truth.plant;
    params.links.push_back({sim.length_m, sim.mass_kg, sim.center_m, sim.link_inertia_kg_m2, sim.rotor_inertia_kg_m2,
                            plant_of(config, joint, truth)});
  }
  return std::make_unique<Chain>(params);
}

Result<std::unique_ptr<Mechanism>> make_model(const robot::RobotConfig& config) {
  MujocoParams params{config.plant.model, std::llround(1e9 * config.plant.step_s), {}};
  params.imu =
      std::ranges::any_of(config.devices, [](const auto& each) { return each.kind == robot::DeviceKind::imu; });
  for (const robot::JointConfig& joint : config.joints) {
    const PlantParams plant = plant_of(config, joint, draw_truth(config, joint));
    params.joints.push_back({joint.name, plant.initial_position_rad, plant.torque_lag_s, plant.torque_max_nm,
                             joint.position_min_rad, joint.position_max_rad});
  }
  return open_mujoco(params);
}

// The plant of a drive without a joint: a free motor.
robot::JointConfig free_joint(std::size_t device) {
  robot::JointConfig joint;
  joint.device = device;
  joint.sim.inertia_kg_m2 = 1e-4;
  return joint;
}

SimDevice make_device(const robot::RobotConfig& config, std::size_t index, const Mechanism* mechanism) {
  const robot::DeviceConfig& device = config.devices[index];
  const auto found = std::find_if(config.joints.begin(), config.joints.end(),
                                  [index](const robot::JointConfig& joint) { return joint.device == index; });
  const bool moves = found != config.joints.end();
  const robot::JointConfig joint = moves ? *found : free_joint(index);
  const JointTransform transform{joint.sign, joint.zero_rad, joint.ratio};
  const Truth truth = draw_truth(config, joint);
  PlantParams plant = plant_of(config, joint, truth);
  if (moves && mechanism != nullptr)
    plant.inertia_kg_m2 = mechanism->inertia_kg_m2(static_cast<std::size_t>(found - config.joints.begin()));
  const auto make = type_of(device.kind).make;
  if (make == nullptr) return {};
  return make({device, config.buses[device.bus], index, joint.sim.encoder_counts, transform, plant, truth.drive});
}

class SimImu final : public ImuSource {
 public:
  explicit SimImu(const Coupling* coupling) : coupling_(coupling) {}
  const ImuReading& imu(std::int64_t now_ns) LITHE_RT override {
    if (coupling_ != nullptr) coupling_->mechanism().read_imu(reading_.value);
    reading_.taken_ns = now_ns;
    return reading_;
  }

 private:
  const Coupling* coupling_;  // null: joints that are independent have no base that moves
  ImuReading reading_{kLevelImu, 0, true};
};

class LoopSimulation final : public Simulation {
 public:
  explicit LoopSimulation(Nodes nodes) : nodes_(std::move(nodes)), imu_(nodes_.coupling.get()) {}

  std::unique_ptr<Bus> open_bus(const robot::RobotConfig& config, std::size_t index) override {
    auto bus = std::make_unique<LoopBus>();
    nodes_.attach(config, index, *bus);
    return bus;
  }
  ImuSource& imu() override { return imu_; }
  void to_start() LITHE_RT override { nodes_.to_start(); }

 private:
  Nodes nodes_;
  SimImu imu_;
};

}  // namespace

Result<Nodes> make_nodes(const robot::RobotConfig& config) {
  std::unique_ptr<Mechanism> mechanism;
  if (config.plant.kind == PlantKind::chain) mechanism = make_chain(config);
  if (config.plant.kind == PlantKind::mujoco) {
    Result<std::unique_ptr<Mechanism>> opened = make_model(config);
    if (!opened) return Error{"[plant] model: " + opened.message()};
    mechanism = std::move(*opened);
  }
  Nodes nodes;
  for (std::size_t i = 0; i < config.devices.size(); ++i)
    nodes.devices.push_back(make_device(config, i, mechanism.get()));
  if (mechanism == nullptr) return nodes;
  nodes.coupling = std::make_unique<Coupling>(std::move(mechanism));
  for (const robot::JointConfig& joint : config.joints) nodes.coupling->add(*nodes.devices[joint.device].drive);
  return nodes;
}

std::unique_ptr<BusNode> make_second_device(const robot::RobotConfig& config, std::size_t device) {
  return make_device(config, device, nullptr).node;
}

Result<std::unique_ptr<Simulation>> make_simulation(const robot::RobotConfig& config) {
  const auto real = std::find_if(config.buses.begin(), config.buses.end(), robot::is_real);
  if (config.plant.kind != PlantKind::independent && real != config.buses.end()) {
    return Error{"[plant] joins all joints, but bus '" + real->name +
                 "' is real and others are simulated; make all of them a \"loop\", or none"};
  }
  Result<Nodes> made = make_nodes(config);
  if (!made) return made.error();
  return std::unique_ptr<Simulation>(std::make_unique<LoopSimulation>(std::move(*made)));
}

Result<std::unique_ptr<Actuators>> open_actuators(const robot::RobotConfig& config, FrameTap* tap) {
  return hal::open_actuators(config, {.make_simulation = make_simulation, .tap = tap});
}

Result<std::unique_ptr<Actuators>> simulate_actuators(robot::RobotConfig config) {
  for (robot::BusConfig& bus : config.buses) bus.kind = robot::BusKind::loop;
  return open_actuators(config);
}

}  // namespace lithe::hal::sim
