// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/moteus/sim/make_sim_moteus.hpp"

#include "spine/hal/moteus/sim/sim_moteus.hpp"

namespace lithe::hal::sim {

std::unique_ptr<BusNode> make_sim_moteus(const SimPlace& place) {
  SimMoteusParams params;
  params.id = place.device.id;
  params.serial = place.index + 1;
  params.joint = place.joint;
  params.servo.encoder_counts = place.encoder_counts;
  params.plant = place.plant;
  params.errors = place.errors;
  return std::make_unique<SimMoteus>(params);
}

void couple_moteus(Coupling& coupling, BusNode& node) { coupling.add(static_cast<SimMoteus&>(node).servo()); }

double moteus_torque_max_nm(const robot::DeviceConfig& /*device*/) { return ServoParams{}.motor_torque_max_nm; }

}  // namespace lithe::hal::sim
