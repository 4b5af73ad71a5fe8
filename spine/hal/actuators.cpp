// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/actuators.hpp"

#include <algorithm>
#include <cmath>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "spine/hal/bus/loop_bus.hpp"
#include "spine/hal/bus_actuators.hpp"
#include "spine/hal/device/canopen_master.hpp"
#include "spine/hal/device/cia402_drive.hpp"
#include "spine/hal/device/moteus_drive.hpp"
#include "spine/hal/open_bus.hpp"
#include "spine/hal/sim/nodes.hpp"

namespace lithe::hal {
namespace {

using robot::BusKind;
using robot::DeviceKind;

// All there is of one robot: its buses, the devices that are simulated, what drives and reads them.
// Contract: as BusActuators
class Hardware final : public Actuators {
 public:
  Hardware(const robot::RobotConfig& config, const std::vector<BusNode*>& far_ends)
      : config_(config), far_ends_(far_ends), actuators_(RawClock::calibrate(), config.guard.lost_after_misses) {}

  Result<> open() {
    for (std::size_t i = 0; i < config_.buses.size(); ++i) {
      if (Result<> opened = add_bus(i); !opened) return opened;
    }
    std::vector<std::size_t> gateway_of(config_.devices.size());
    for (std::size_t i = 0; i < config_.devices.size(); ++i) {
      const robot::DeviceConfig& device = config_.devices[i];
      if (device.kind != DeviceKind::gateway) continue;
      gateway_of[i] = actuators_.add_gateway(device.bus, device.id, std::llround(1e9 * device.watchdog_s));
    }
    for (const robot::JointConfig& joint : config_.joints) add_joint(joint);
    for (const robot::SensorConfig& sensor : config_.sensors) {
      actuators_.add_sensor(gateway_of[sensor.device], block_of(sensor.kind), sensor.channel, sensor.scale,
                            sensor.offset);
    }
    return done();
  }

  void cycle(const ActuatorCommand& command, ActuatorState& state, std::int64_t now_ns) LITHE_RT override {
    actuators_.cycle(command, state, now_ns);
  }
  const ReplyCounters& counters() const LITHE_RT override { return actuators_.counters(); }

  void share_core() override { actuators_.share_core(); }
  void service() override {
    for (Bus* bus : real_buses_) bus->service();
  }
  std::string trouble() const override {
    std::string words;
    for (const auto& [name, bus] : named_buses_) {
      const std::string why = bus->why_down();
      if (!why.empty()) words += (words.empty() ? "bus '" : "; bus '") + name + "': " + why;
    }
    for (const auto& [name, drive] : slow_drives_) {
      const std::string why = drive->why_not_ready();
      if (!why.empty()) words += (words.empty() ? "drive '" : "; drive '") + name + "': " + why;
    }
    return words;
  }

 private:
  static gateway::Block block_of(robot::SensorKind kind) {
    return kind == robot::SensorKind::analog    ? gateway::Block::analog
           : kind == robot::SensorKind::digital ? gateway::Block::digital
                                                : gateway::Block::imu;
  }

  cia402::DriverParams cia402_params(const robot::DeviceConfig& device, const robot::JointConfig& joint) const {
    cia402::DriverParams params;
    params.id = device.id;
    params.watchdog_s = device.watchdog_s;
    params.period_s = device.rate_divider / config_.rate_hz;
    params.mode = device.mode == robot::DriveMode::position   ? cia402::Mode::position
                  : device.mode == robot::DriveMode::velocity ? cia402::Mode::velocity
                                                              : cia402::Mode::torque;
    params.counts_per_rev = device.counts_per_rev;
    params.rated_torque_nm = device.rated_torque_nm;
    params.torque_max_nm = joint.torque_max_nm;
    params.joint = {joint.sign, joint.zero_rad, joint.ratio};
    return params;
  }

  Result<> add_bus(std::size_t index) {
    const robot::BusConfig& config = config_.buses[index];
    bool canopen = false;
    double watchdog_s = 10;
    for (const robot::DeviceConfig& device : config_.devices) {
      if (device.bus != index || device.kind != DeviceKind::cia402) continue;
      canopen = true;
      watchdog_s = std::min(watchdog_s, device.watchdog_s);
    }
    std::unique_ptr<BusMaster> master;
    if (canopen) {
      master = std::make_unique<canopen::CanopenMaster>(canopen::MasterParams{.heartbeat_s = watchdog_s / 4});
    }
    std::unique_ptr<Bus> bus;
    if (config.kind == BusKind::loop) {
      bus = simulated_bus(index);
    } else {
      Result<std::unique_ptr<Bus>> opened = open_bus(config);
      if (!opened) return opened.error();
      bus = std::move(*opened);
      real_buses_.push_back(bus.get());
      named_buses_.emplace_back(config.name, bus.get());
    }
    actuators_.add_bus(std::move(bus), canopen ? Addressing::canopen : Addressing::moteus, std::move(master));
    return done();
  }

  std::unique_ptr<Bus> simulated_bus(std::size_t index) {
    auto bus = std::make_unique<LoopBus>();
    if (!far_ends_.empty()) {
      bus->attach(*far_ends_[index]);
      return bus;
    }
    for (std::size_t i = 0; i < config_.devices.size(); ++i) {
      if (config_.devices[i].bus != index) continue;
      nodes_.push_back(sim::make_node(config_, i));
      bus->attach(*nodes_.back());
    }
    return bus;
  }

  void add_joint(const robot::JointConfig& joint) {
    const robot::DeviceConfig& device = config_.devices[joint.device];
    std::unique_ptr<Drive> drive;
    if (device.kind == DeviceKind::cia402) {
      auto own = std::make_unique<cia402::Cia402Drive>(cia402_params(device, joint));
      slow_drives_.emplace_back(device.name, own.get());
      drive = std::move(own);
    } else {
      moteus::DriverParams params;
      params.id = device.id;
      params.watchdog_s = device.watchdog_s;
      params.joint = {joint.sign, joint.zero_rad, joint.ratio};
      drive = std::make_unique<moteus::MoteusDrive>(params);
    }
    actuators_.add_joint(device.bus, device.id, std::move(drive), device.rate_divider);
  }

  const robot::RobotConfig config_;
  const std::vector<BusNode*> far_ends_;
  std::vector<std::unique_ptr<BusNode>> nodes_;  // outlive the buses that reach them
  std::vector<Bus*> real_buses_;
  std::vector<std::pair<std::string, const Bus*>> named_buses_;
  std::vector<std::pair<std::string, const cia402::Cia402Drive*>> slow_drives_;  // they are set up before they answer
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

Result<std::unique_ptr<Actuators>> open(const robot::RobotConfig& config, const std::vector<BusNode*>& far_ends) {
  if (const Result<> sound = check(config); !sound) return sound.error();
  auto hardware = std::make_unique<Hardware>(config, far_ends);
  if (Result<> opened = hardware->open(); !opened) return Error{config.path + ": " + opened.message()};
  return std::unique_ptr<Actuators>(std::move(hardware));
}

}  // namespace

Result<std::unique_ptr<Actuators>> open_actuators(const robot::RobotConfig& config) { return open(config, {}); }

Result<std::unique_ptr<Actuators>> simulate_actuators(robot::RobotConfig config,
                                                      const std::vector<BusNode*>& far_ends) {
  for (robot::BusConfig& bus : config.buses) bus.kind = BusKind::loop;
  if (!far_ends.empty() && far_ends.size() != config.buses.size()) {
    return Error{config.path + ": " + std::to_string(config.buses.size()) + " buses, but far ends for " +
                 std::to_string(far_ends.size())};
  }
  return open(config, far_ends);
}

}  // namespace lithe::hal
