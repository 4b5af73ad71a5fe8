// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/cia402/sim/make_sim_cia402.hpp"

#include "spine/hal/cia402/sim/sim_cia402.hpp"

namespace lithe::hal::sim {

std::unique_ptr<BusNode> make_sim_cia402(const SimPlace& place) {
  SimCia402Params params;
  params.id = place.device.id;
  params.servo.counts_per_rev = place.device.counts_per_rev;
  params.servo.rated_torque_nm = place.device.rated_torque_nm;
  params.servo.motor_torque_max_nm = cia402_torque_max_nm(place.device);
  params.joint = place.joint;
  params.plant = place.plant;
  params.errors = place.errors;
  return std::make_unique<SimCia402>(params);
}

void couple_cia402(Coupling& coupling, BusNode& node) { coupling.add(static_cast<SimCia402&>(node).servo()); }

double cia402_torque_max_nm(const robot::DeviceConfig& device) { return 3 * device.rated_torque_nm; }

}  // namespace lithe::hal::sim
