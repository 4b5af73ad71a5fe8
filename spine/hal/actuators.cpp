// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/actuators.hpp"

#include <set>
#include <string>
#include <utility>
#include <vector>

#include "spine/hal/bus/loop_bus.hpp"
#include "spine/hal/bus_actuators.hpp"
#include "spine/hal/device/moteus_drive.hpp"
#include "spine/hal/sim/sim_moteus.hpp"

namespace lithe::hal {
namespace {

// Keeps the simulated devices alive as long as the buses that reach them.
// Contract: as BusActuators
class SimulatedRobot final : public Actuators {
 public:
  void cycle(const ActuatorCommand& command, ActuatorState& state, std::int64_t now_ns) LITHE_RT override {
    actuators_.cycle(command, state, now_ns);
  }
  const ReplyCounters& counters() const LITHE_RT override { return actuators_.counters(); }

  void add_bus() {
    auto bus = std::make_unique<LoopBus>();
    wires_.push_back(bus.get());
    actuators_.add_bus(std::move(bus), Addressing::moteus);
  }

  void add_joint(const robot::DeviceConfig& device, const robot::JointConfig& joint) {
    const JointTransform transform{joint.sign, joint.zero_rad, joint.ratio};
    sim::SimMoteusParams params;
    params.id = device.id;
    params.joint = transform;
    params.servo.encoder_counts = joint.sim.encoder_counts;
    params.plant = {joint.sim.inertia_kg_m2,        joint.sim.mgl_nm,
                    joint.sim.viscous_nm_s_rad,     joint.sim.coulomb_nm,
                    joint.sim.cogging_nm,           joint.sim.cogging_per_rev,
                    joint.sim.torque_lag_s,         params.servo.motor_torque_max_nm * joint.ratio,
                    joint.sim.initial_position_rad, joint.sim.seed};
    drives_.push_back(std::make_unique<sim::SimMoteus>(params));
    wires_[device.bus]->attach(*drives_.back());
    actuators_.add_joint(
        device.bus, device.id,
        std::make_unique<moteus::MoteusDrive>(moteus::DriverParams{device.id, device.watchdog_s, transform}));
  }

 private:
  std::vector<std::unique_ptr<sim::SimMoteus>> drives_;
  std::vector<LoopBus*> wires_;
  BusActuators actuators_;
};

// load_robot has checked all this; a config built by hand has not been checked by anyone.
Result<> check(const robot::RobotConfig& config) {
  if (config.joints.empty()) return Error{config.path + ": no joint to drive; add a [[joint]]"};
  if (config.joints.size() > kMaxJoints) {
    return Error{config.path + ": " + std::to_string(config.joints.size()) + " joints, built for " +
                 std::to_string(kMaxJoints) + "; build with -DLITHE_NJ=" + std::to_string(config.joints.size())};
  }
  std::set<std::pair<std::size_t, std::uint32_t>> taken;
  for (const robot::JointConfig& joint : config.joints) {
    const std::string where = config.path + ": joint '" + joint.name + "': ";
    if (joint.device >= config.devices.size()) return Error{where + "has no device; name one of the [[device]] tables"};
    const robot::DeviceConfig& device = config.devices[joint.device];
    if (device.bus >= config.buses.size()) {
      return Error{where + "device '" + device.name + "' has no bus; name one of the [[bus]] tables"};
    }
    if (device.id < 1 || device.id > 126) {
      return Error{where + "device '" + device.name + "' has id " + std::to_string(device.id) + "; use 1 to 126"};
    }
    if (!taken.insert({device.bus, device.id}).second) {
      return Error{where + "id " + std::to_string(device.id) + " is already taken on bus '" +
                   config.buses[device.bus].name + "'; give each device its own"};
    }
    if (!(joint.ratio > 0) || (joint.sign != 1 && joint.sign != -1)) {
      return Error{where + "needs a ratio above 0 and a sign of 1 or -1"};
    }
    if (!(joint.sim.inertia_kg_m2 > 0)) return Error{where + "needs an inertia above 0 to be simulated"};
  }
  return done();
}

}  // namespace

Result<std::unique_ptr<Actuators>> open_actuators(const robot::RobotConfig& config) {
  if (const Result<> sound = check(config); !sound) return sound.error();
  auto simulated = std::make_unique<SimulatedRobot>();
  for (std::size_t i = 0; i < config.buses.size(); ++i) simulated->add_bus();
  for (const robot::JointConfig& joint : config.joints) simulated->add_joint(config.devices[joint.device], joint);
  return std::unique_ptr<Actuators>(std::move(simulated));
}

}  // namespace lithe::hal
