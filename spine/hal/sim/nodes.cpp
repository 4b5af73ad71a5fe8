// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/sim/nodes.hpp"

#include <algorithm>

#include "spine/hal/sim/sim_cia402.hpp"
#include "spine/hal/sim/sim_gateway.hpp"
#include "spine/hal/sim/sim_moteus.hpp"

namespace lithe::hal::sim {
namespace {

using robot::DeviceKind;

// The IMU of a board is on none of its buses.
class Nobody final : public BusNode {
 public:
  void on_frame(const Frame&, std::int64_t, FrameQueue&) LITHE_RT override {}
};

constexpr std::int64_t kGatewayPeriodNs = 1'000'000;

PlantParams plant_of(const robot::JointConfig& joint, double motor_torque_max_nm) {
  const robot::PlantConfig& sim = joint.sim;
  return {sim.inertia_kg_m2,        sim.mgl_nm,
          sim.viscous_nm_s_rad,     sim.coulomb_nm,
          sim.cogging_nm,           sim.cogging_per_rev,
          sim.torque_lag_s,         motor_torque_max_nm * joint.ratio,
          sim.initial_position_rad, sim.seed};
}

// A motor of its own, for a drive that moves no joint.
robot::JointConfig free_joint() {
  robot::JointConfig joint;
  joint.sim.inertia_kg_m2 = 1e-4;
  return joint;
}

}  // namespace

std::unique_ptr<BusNode> make_node(const robot::RobotConfig& config, std::size_t index) {
  const robot::DeviceConfig& device = config.devices[index];
  if (device.kind == DeviceKind::imu) return std::make_unique<Nobody>();
  const auto found = std::find_if(config.joints.begin(), config.joints.end(),
                                  [index](const robot::JointConfig& joint) { return joint.device == index; });
  const robot::JointConfig joint = found != config.joints.end() ? *found : free_joint();
  const JointTransform transform{joint.sign, joint.zero_rad, joint.ratio};
  if (device.kind == DeviceKind::gateway) {
    return std::make_unique<SimGateway>(device.id, kGatewayPeriodNs, robot::is_fd(config.buses[device.bus]));
  }
  if (device.kind == DeviceKind::cia402) {
    SimCia402Params params;
    params.id = device.id;
    params.servo.counts_per_rev = device.counts_per_rev;
    params.servo.rated_torque_nm = device.rated_torque_nm;
    params.servo.motor_torque_max_nm = 3 * device.rated_torque_nm;
    params.joint = transform;
    params.plant = plant_of(joint, params.servo.motor_torque_max_nm);
    return std::make_unique<SimCia402>(params);
  }
  SimMoteusParams params;
  params.id = device.id;
  params.serial = index + 1;
  params.joint = transform;
  params.servo.encoder_counts = joint.sim.encoder_counts;
  params.plant = plant_of(joint, params.servo.motor_torque_max_nm);
  return std::make_unique<SimMoteus>(params);
}

}  // namespace lithe::hal::sim
