// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/robot_hardware.hpp"

#include <algorithm>
#include <cmath>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "spine/hal/bus/loop/loop_bus.hpp"
#include "spine/hal/bus_actuators.hpp"
#include "spine/hal/canopen/canopen_master.hpp"
#include "spine/hal/cia402/cia402_drive.hpp"
#include "spine/hal/moteus/moteus_drive.hpp"
#include "spine/hal/open_bus.hpp"
#include "spine/hal/sim/nodes.hpp"

namespace lithe::hal {
namespace {

using robot::BusKind;
using robot::DeviceKind;

// Simulated IMU for a board that is not there: level and at rest.
class LevelImu final : public ImuSource {
 public:
  const ImuReading& imu(std::int64_t now_ns) LITHE_RT override {
    reading_.taken_ns = now_ns;
    return reading_;
  }

 private:
  static constexpr double kGravityMps2 = 9.80665;  // an accelerometer at rest measures gravity upwards
  ImuReading reading_{{1, 0, 0, 0, 0, 0, 0, 0, 0, kGravityMps2}, 0, true};
};

// The hardware of one robot: buses, simulated devices, drivers.
// Contract: as BusActuators
class Hardware final : public Actuators {
 public:
  Hardware(const robot::RobotConfig& config, std::unique_ptr<Pi3hatPort> pi3hat, FrameTap* tap,
           const std::vector<BusNode*>& far_ends)
      : config_(config),
        far_ends_(far_ends),
        tap_(tap),
        opener_(config.buses, false, std::move(pi3hat)),
        actuators_(RawClock::calibrate(), config.guard.lost_after_misses) {}

  Result<> open() {
    if (Result<> simulated = simulate(); !simulated) return simulated;
    for (std::size_t i = 0; i < config_.buses.size(); ++i) {
      if (Result<> opened = add_bus(i); !opened) return opened;
    }
    for (const robot::JointConfig& joint : config_.joints) add_joint(joint);
    add_sensors();
    return done();
  }

  void cycle(const ActuatorCommand& command, ActuatorState& state, std::int64_t now_ns) LITHE_RT override {
    if (command.reset_simulation) nodes_.to_start();
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
    for (const auto& [name, drive] : drives_) {
      const std::string why = drive->why_not_ready();
      if (!why.empty()) words += (words.empty() ? "drive '" : "; drive '") + name + "': " + why;
    }
    return words;
  }
  std::string tell_buses() const override {
    std::string words;
    for (const auto& [name, bus] : named_buses_) {
      const BusStatistics& n = bus->statistics();
      if (n.refused + n.late + n.malformed + n.errors + n.reopened == 0) continue;
      words += (words.empty() ? "bus '" : "; bus '") + name + "': " + std::to_string(n.sent) + " sent, " +
               std::to_string(n.received) + " received, " + std::to_string(n.refused) + " refused, " +
               std::to_string(n.late) + " late, " + std::to_string(n.malformed) + " malformed, " +
               std::to_string(n.errors) + " errors, " + std::to_string(n.reopened) + " times opened again";
    }
    return words;
  }

 private:
  // The devices behind simulated buses, if there are any.
  Result<> simulate() {
    if (!far_ends_.empty()) return done();
    const auto is_loop = [](const robot::BusConfig& bus) { return bus.kind == BusKind::loop; };
    if (std::none_of(config_.buses.begin(), config_.buses.end(), is_loop)) return done();
    if (config_.plant.kind != robot::PlantKind::independent) {
      const auto real = std::find_if_not(config_.buses.begin(), config_.buses.end(), is_loop);
      if (real != config_.buses.end()) {
        return Error{"[plant] joins all joints, but bus '" + real->name +
                     "' is real and others are simulated; make all of them a \"loop\", or none"};
      }
    }
    Result<sim::Nodes> made = sim::make_nodes(config_);
    if (!made) return made.error();
    nodes_ = std::move(*made);
    return done();
  }

  static gateway::Block block_of(robot::SensorKind kind) {
    return kind == robot::SensorKind::analog    ? gateway::Block::analog
           : kind == robot::SensorKind::digital ? gateway::Block::digital
                                                : gateway::Block::imu;
  }

  moteus::DriverParams moteus_params(const robot::DeviceConfig& device, const robot::JointConfig& joint) const {
    moteus::DriverParams params;
    params.id = device.id;
    params.watchdog_s = device.watchdog_s;
    params.joint = {joint.sign, joint.zero_rad, joint.ratio};
    params.damp_kd_nm_s_rad = joint.safe_kd_nm_s_rad;
    params.damp_torque_max_nm = joint.torque_max_nm / joint.ratio;
    params.velocity_max_rad_s = joint.velocity_max_rad_s;
    params.torque_step_nm = joint.torque_slew_nm_s * device.rate_divider / config_.rate_hz;
    params.ask_settings = true;
    params.kp_max_nm_rad = joint.kp_max_nm_rad;
    params.kd_max_nm_s_rad = joint.kd_max_nm_s_rad;
    moteus::use_frames(device.frames, params);
    return params;
  }

  cia402::DriverParams cia402_params(const robot::DeviceConfig& device, const robot::JointConfig& joint) const {
    cia402::DriverParams params;
    params.id = device.id;
    params.watchdog_s = device.watchdog_s;
    params.period_s = device.rate_divider / config_.rate_hz;
    params.divider = device.rate_divider;
    params.lost_after_misses = config_.guard.lost_after_misses;
    params.mode = device.mode == robot::DriveMode::position   ? cia402::Mode::position
                  : device.mode == robot::DriveMode::velocity ? cia402::Mode::velocity
                                                              : cia402::Mode::torque;
    params.counts_per_rev = device.counts_per_rev;
    params.rated_torque_nm = device.rated_torque_nm;
    params.torque_max_nm = joint.torque_max_nm;
    params.torque_slew_nm_s = joint.torque_slew_nm_s;
    params.velocity_max_rad_s = joint.velocity_max_rad_s;
    params.velocity_fault_rad_s = joint.velocity_max_rad_s * config_.guard.velocity_overrun;
    params.deceleration_rad_s2 = joint.deceleration_rad_s2;
    params.position_min_rad = joint.position_min_rad - config_.guard.position_overrun_rad;
    params.position_max_rad = joint.position_max_rad + config_.guard.position_overrun_rad;
    params.soft_start_s = config_.guard.soft_start_s;
    params.joint = {joint.sign, joint.zero_rad, joint.ratio};
    return params;
  }

  Result<> add_bus(std::size_t index) {
    const robot::BusConfig& config = config_.buses[index];
    bool canopen = false;
    double watchdog_s = 10;
    std::uint32_t divider = 1;
    for (const robot::DeviceConfig& device : config_.devices) {
      if (device.bus != index || device.kind != DeviceKind::cia402) continue;
      canopen = true;
      watchdog_s = std::min(watchdog_s, device.watchdog_s);
      divider = device.rate_divider;
    }
    std::unique_ptr<BusMaster> master;
    if (canopen) {
      master = std::make_unique<canopen::CanopenMaster>(
          canopen::MasterParams{.heartbeat_s = watchdog_s / canopen::kHeartbeatsPerWatchdog, .divider = divider});
    }
    std::unique_ptr<Bus> bus;
    if (config.kind == BusKind::loop) {
      auto loop = std::make_unique<LoopBus>();
      if (far_ends_.empty()) {
        nodes_.attach(config_, index, *loop);
      } else {
        loop->attach(*far_ends_[index]);
      }
      bus = std::move(loop);
    } else {
      Result<std::unique_ptr<Bus>> opened = opener_.open(config);
      if (!opened) return opened.error();
      bus = std::move(*opened);
      real_buses_.push_back(bus.get());
      named_buses_.emplace_back(config.name, bus.get());
    }
    if (tap_ != nullptr) bus = std::make_unique<TappedBus>(std::move(bus), static_cast<std::uint32_t>(index), *tap_);
    actuators_.add_bus(std::move(bus), canopen ? Addressing::canopen : Addressing::moteus, std::move(master));
    return done();
  }

  void add_sensors() {
    std::vector<std::size_t> source_of(config_.devices.size());
    for (std::size_t i = 0; i < config_.devices.size(); ++i) {
      const robot::DeviceConfig& device = config_.devices[i];
      const std::int64_t stale_ns = std::llround(1e9 * device.watchdog_s);
      if (device.kind == DeviceKind::gateway) source_of[i] = actuators_.add_gateway(device.bus, device.id, stale_ns);
      if (device.kind == DeviceKind::imu) source_of[i] = actuators_.add_imu(imu_of(device), stale_ns);
    }
    for (const robot::SensorConfig& sensor : config_.sensors) {
      const std::size_t source = source_of[sensor.device];
      if (config_.devices[sensor.device].kind == DeviceKind::imu) {
        actuators_.add_imu_sensor(source, sensor.channel, sensor.scale, sensor.offset);
      } else {
        actuators_.add_sensor(source, block_of(sensor.kind), sensor.channel, sensor.scale, sensor.offset);
      }
    }
  }

  ImuSource& imu_of(const robot::DeviceConfig& device) {
    if (config_.buses[device.bus].kind != BusKind::pi3hat) return level_;
    opener_.board()->want_imu();
    return *opener_.board();
  }

  void add_joint(const robot::JointConfig& joint) {
    const robot::DeviceConfig& device = config_.devices[joint.device];
    std::unique_ptr<Drive> drive;
    if (device.kind == DeviceKind::cia402) {
      drive = std::make_unique<cia402::Cia402Drive>(cia402_params(device, joint));
    } else {
      drive = std::make_unique<moteus::MoteusDrive>(moteus_params(device, joint));
    }
    drives_.emplace_back(device.name, drive.get());
    actuators_.add_joint(device.bus, device.id, std::move(drive), device.rate_divider);
  }

  const robot::RobotConfig config_;
  const std::vector<BusNode*> far_ends_;
  FrameTap* tap_;
  BusOpener opener_;
  LevelImu level_;
  sim::Nodes nodes_;  // must outlive the buses
  std::vector<Bus*> real_buses_;
  std::vector<std::pair<std::string, const Bus*>> named_buses_;
  std::vector<std::pair<std::string, const Drive*>> drives_;
  BusActuators actuators_;
};

// load_robot checks all this too; a config made in code has not been checked.
Result<> check_device(const robot::RobotConfig& config, const robot::DeviceConfig& device, const std::string& where) {
  if (device.bus >= config.buses.size()) {
    return Error{where + "device '" + device.name + "' has no bus; name one of the [[bus]] tables"};
  }
  if (device.id < 1 || device.id > 126) {
    return Error{where + "device '" + device.name + "' has id " + std::to_string(device.id) + "; use 1 to 126"};
  }
  if (device.rate_divider < 1) return Error{where + "device '" + device.name + "' needs a rate_divider of 1 or more"};
  return done();
}

Result<> check_joints(const robot::RobotConfig& config) {
  std::set<std::pair<std::size_t, std::uint32_t>> taken;
  for (const robot::JointConfig& joint : config.joints) {
    const std::string where = config.path + ": joint '" + joint.name + "': ";
    if (joint.device >= config.devices.size()) return Error{where + "has no device; name one of the [[device]] tables"};
    const robot::DeviceConfig& device = config.devices[joint.device];
    if (Result<> sound = check_device(config, device, where); !sound) return sound;
    if (device.kind == DeviceKind::gateway) return Error{where + "a gateway drives nothing; name a drive"};
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

Result<> check_sensors(const robot::RobotConfig& config) {
  for (const robot::DeviceConfig& device : config.devices) {
    if (robot::is_drive(device.kind) || device.kind == DeviceKind::imu) continue;
    if (Result<> sound = check_device(config, device, config.path + ": "); !sound) return sound;
  }
  if (config.sensors.size() > robot::kMaxSensors) {
    return Error{config.path + ": " + std::to_string(config.sensors.size()) + " sensors; a law is given " +
                 std::to_string(robot::kMaxSensors)};
  }
  for (const robot::SensorConfig& sensor : config.sensors) {
    const std::string where = config.path + ": sensor '" + sensor.name + "': ";
    if (sensor.device >= config.devices.size() || robot::is_drive(config.devices[sensor.device].kind)) {
      return Error{where + "is on no gateway; name a [[device]] of kind \"gateway\" or \"imu\""};
    }
    const bool imu = config.devices[sensor.device].kind == DeviceKind::imu;
    const std::size_t channels = imu ? kImuChannels : gateway::kChannels;
    if (sensor.channel >= channels) {
      return Error{where + (imu ? "an imu" : "a gateway") + " has channels 0 to " + std::to_string(channels - 1)};
    }
  }
  return done();
}

Result<> check(const robot::RobotConfig& config) {
  if (config.joints.empty()) return Error{config.path + ": no joint to drive; add a [[joint]]"};
  if (config.joints.size() > kMaxJoints) {
    return Error{config.path + ": " + std::to_string(config.joints.size()) + " joints, built for " +
                 std::to_string(kMaxJoints) + "; build with -DLITHE_NJ=" + std::to_string(config.joints.size())};
  }
  if (Result<> sound = check_joints(config); !sound) return sound;
  return check_sensors(config);
}

Result<std::unique_ptr<Actuators>> open(const robot::RobotConfig& config, std::unique_ptr<Pi3hatPort> pi3hat,
                                        FrameTap* tap, const std::vector<BusNode*>& far_ends) {
  if (const Result<> sound = check(config); !sound) return sound.error();
  auto hardware = std::make_unique<Hardware>(config, std::move(pi3hat), tap, far_ends);
  if (Result<> opened = hardware->open(); !opened) return Error{config.path + ": " + opened.message()};
  return std::unique_ptr<Actuators>(std::move(hardware));
}

}  // namespace

Result<std::unique_ptr<Actuators>> open_actuators(const robot::RobotConfig& config, std::unique_ptr<Pi3hatPort> pi3hat,
                                                  FrameTap* tap) {
  return open(config, std::move(pi3hat), tap, {});
}

Result<std::unique_ptr<Actuators>> simulate_actuators(robot::RobotConfig config,
                                                      const std::vector<BusNode*>& far_ends) {
  for (robot::BusConfig& bus : config.buses) bus.kind = BusKind::loop;
  if (!far_ends.empty() && far_ends.size() != config.buses.size()) {
    return Error{config.path + ": " + std::to_string(config.buses.size()) + " buses, but far ends for " +
                 std::to_string(far_ends.size())};
  }
  return open(config, nullptr, nullptr, far_ends);
}

}  // namespace lithe::hal
