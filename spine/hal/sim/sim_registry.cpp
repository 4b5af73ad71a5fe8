// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/sim/simulate.hpp"

#include <array>

#include "spine/hal/bus/fdcanusb/sim_fdcanusb.hpp"
#include "spine/hal/bus/slcan/sim_slcan.hpp"
#include "spine/hal/cia401/sim/sim_cia401.hpp"
#include "spine/hal/cia402/sim/sim_cia402.hpp"
#include "spine/hal/gateway/sim/sim_gateway.hpp"
#include "spine/hal/moteus/sim/sim_moteus.hpp"

namespace lithe::hal::sim {
namespace {

using robot::BusKind;
using robot::DeviceKind;

template <class Adapter>
std::unique_ptr<SimAdapter> make_adapter() {
  return std::make_unique<Adapter>();
}

SimDevice make_sim_gateway(const SimPlace& place) {
  constexpr std::int64_t kPeriodNs = 1'000'000;
  return {std::make_unique<SimGateway>(place.device.id, kPeriodNs, robot::is_fd(place.bus))};
}

constexpr std::uint32_t kOfDrives = bit_of(InjectedFault::power_loss) | bit_of(InjectedFault::over_temperature) |
                                    bit_of(InjectedFault::encoder_lost) | bit_of(InjectedFault::device_fault) |
                                    bit_of(InjectedFault::watchdog_trip) | bit_of(InjectedFault::other_map);
constexpr std::uint32_t kOfSensors = bit_of(InjectedFault::power_loss) | bit_of(InjectedFault::other_map);

constexpr std::array<SimDeviceType, robot::kDeviceFacts.size()> kDevices{{
    {.kind = DeviceKind::moteus,
     .make = make_sim_moteus,
     .motor_torque_max_nm = moteus_torque_max_nm,
     .injected = kOfDrives | bit_of(InjectedFault::homing_lost)},
    {.kind = DeviceKind::cia402,
     .make = make_sim_cia402,
     .motor_torque_max_nm = cia402_torque_max_nm,
     .injected = kOfDrives},
    {.kind = DeviceKind::gateway, .make = make_sim_gateway, .injected = kOfSensors},
    {.kind = DeviceKind::imu},  // on no bus: Simulation::imu() is its reading
    {.kind = DeviceKind::cia401, .make = make_sim_cia401, .injected = kOfSensors},
}};

constexpr SimBusType kBuses[] = {
    {.kind = BusKind::fdcanusb, .adapter = "fdcanusb", .make_adapter = make_adapter<SimFdcanusb>},  // the usual one
    {.kind = BusKind::slcan, .adapter = "slcan", .make_adapter = make_adapter<SimSlcan>},
    {.kind = BusKind::socketcan, .adapter = "socketcan"},
};

static_assert(robot::in_order(kDevices));

}  // namespace

const SimDeviceType& type_of(robot::DeviceKind kind) { return kDevices[static_cast<std::size_t>(kind)]; }

const SimBusType& type_of(robot::BusKind kind) {
  for (const SimBusType& row : kBuses)
    if (row.kind == kind) return row;
  return kBuses[0];
}

}  // namespace lithe::hal::sim
