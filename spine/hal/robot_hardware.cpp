// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/robot_hardware.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <string>
#include <utility>
#include <vector>

#include "spine/hal/bus_actuators.hpp"
#include "spine/hal/registry.hpp"

namespace lithe::hal {
namespace {

// The hardware of one robot: buses, drivers, devices that measure.
// Contract: as BusActuators
class Hardware final : public Actuators {
 public:
  Hardware(const robot::RobotConfig& config, FrameTap* tap, OpenBoard open_board)
      : config_(config),
        tap_(tap),
        opener_(config.buses, false, std::move(open_board)),
        actuators_(RawClock::calibrate(), config.guard.lost_after_misses) {}

  Result<> open(const MakeSimulation& make_simulation) {
    if (Result<> simulated = simulate(make_simulation); !simulated) return simulated;
    for (std::size_t i = 0; i < config_.buses.size(); ++i)
      if (Result<> opened = add_bus(i); !opened) return opened;
    for (const robot::JointConfig& joint : config_.joints) add_joint(joint);
    add_sensors();
    return done();
  }

  void cycle(const ActuatorCommand& command, ActuatorState& state, std::int64_t now_ns) LITHE_RT override {
    if (command.reset_simulation && simulation_ != nullptr) simulation_->to_start();
    actuators_.cycle(command, state, now_ns);
  }
  const ReplyCounters& counters() const LITHE_RT override { return actuators_.counters(); }

  void share_core() override { actuators_.share_core(); }
  void service() override {
    for (const auto& [name, bus] : named_buses_) bus->service();
  }
  std::string why_not_ready() const override {
    std::string words;
    const auto add = [&words](const char* what, const std::string& name, const std::string& why) {
      if (!why.empty()) words += (words.empty() ? "" : "; ") + std::string(what) + " '" + name + "': " + why;
    };
    for (const auto& [name, bus] : named_buses_) add("bus", name, bus->why_down());
    for (const auto& [name, drive] : drives_) add("drive", name, drive->why_not_ready());
    for (const auto& [name, device] : measuring_) add("device", name, device->why_not_ready());
    return words;
  }
  std::string tell_buses() const override {
    std::string words;
    for (const auto& [name, bus] : named_buses_) {
      const BusStatistics& n = bus->statistics();
      if (n.refused + n.late + n.malformed + n.errors + n.reopened == 0) continue;
      words += fmt::format(
          "{}bus '{}': {} sent, {} received, {} refused, {} late, {} malformed, {} errors, {} times "
          "opened again",
          words.empty() ? "" : "; ", name, n.sent, n.received, n.refused, n.late, n.malformed, n.errors, n.reopened);
    }
    return words;
  }

 private:
  // The devices behind simulated buses, if there are any.
  Result<> simulate(const MakeSimulation& make_simulation) {
    const auto loop = std::find_if_not(config_.buses.begin(), config_.buses.end(), robot::is_real);
    if (loop == config_.buses.end()) return done();
    if (!make_simulation) {
      return Error{"bus '" + loop->name +
                   "' is simulated, and this program drives real buses only; start lithe-spine-sim"};
    }
    Result<std::unique_ptr<Simulation>> made = make_simulation(config_);
    if (!made) return made.error();
    simulation_ = std::move(*made);
    return done();
  }

  static Block block_of(robot::SensorKind kind) { return static_cast<Block>(kind); }

  Result<> add_bus(std::size_t index) {
    const robot::BusConfig& config = config_.buses[index];
    std::unique_ptr<BusMaster> master;
    SenderOf sender_of = nullptr;
    for (const robot::DeviceConfig& device : config_.devices) {
      if (device.bus != index) continue;
      const DeviceType& type = type_of(device.kind);
      if (type.sender_of != nullptr) sender_of = type.sender_of;
      if (type.make_master != nullptr && master == nullptr) master = type.make_master(config_, index);
    }
    std::unique_ptr<Bus> bus;
    if (!robot::is_real(config)) {
      bus = simulation_->open_bus(config_, index);
    } else {
      Result<std::unique_ptr<Bus>> opened = opener_.open(config);
      if (!opened) return opened.error();
      bus = std::move(*opened);
      named_buses_.emplace_back(config.name, bus.get());
    }
    if (tap_ != nullptr) bus = std::make_unique<TappedBus>(std::move(bus), static_cast<std::uint32_t>(index), *tap_);
    actuators_.add_bus(std::move(bus), sender_of, std::move(master));
    return done();
  }

  void add_sensors() {
    std::vector<std::size_t> place_of(config_.devices.size());
    for (std::size_t i = 0; i < config_.devices.size(); ++i) {
      const robot::DeviceConfig& device = config_.devices[i];
      const DeviceType& type = type_of(device.kind);
      std::unique_ptr<SensorDevice> made;
      if (type.make_sensors != nullptr) made = type.make_sensors(device);
      if (type.make_on_board != nullptr) made = type.make_on_board(device, imu_of(device));
      if (made == nullptr) continue;
      measuring_.emplace_back(device.name, made.get());
      place_of[i] = actuators_.add_sensors(device.bus, std::move(made));
    }
    for (const robot::SensorConfig& sensor : config_.sensors) {
      actuators_.add_sensor(place_of[sensor.device], block_of(sensor.kind), sensor.channel, sensor.scale,
                            sensor.offset);
    }
  }

  ImuSource& imu_of(const robot::DeviceConfig& device) {
    const robot::BusConfig& bus = config_.buses[device.bus];
    return robot::is_real(bus) ? opener_.board(bus.kind).want_imu() : simulation_->imu();
  }

  void add_joint(const robot::JointConfig& joint) {
    const robot::DeviceConfig& device = config_.devices[joint.device];
    std::unique_ptr<Drive> drive = type_of(device.kind).make_drive(config_, joint);
    drives_.emplace_back(device.name, drive.get());
    actuators_.add_joint(device.bus, device.id, std::move(drive), device.rate_divider);
  }

  const robot::RobotConfig config_;
  FrameTap* tap_;
  BusOpener opener_;
  std::unique_ptr<Simulation> simulation_;                 // must outlive the buses
  std::vector<std::pair<std::string, Bus*>> named_buses_;  // the real ones
  std::vector<std::pair<std::string, const Drive*>> drives_;
  std::vector<std::pair<std::string, const SensorDevice*>> measuring_;
  BusActuators actuators_;
};

}  // namespace

Result<std::unique_ptr<Actuators>> open_actuators(const robot::RobotConfig& config, HardwareOptions options) {
  auto hardware = std::make_unique<Hardware>(config, options.tap, std::move(options.open_board));
  if (Result<> opened = hardware->open(options.make_simulation); !opened)
    return Error{config.path + ": " + opened.message()};
  return std::unique_ptr<Actuators>(std::move(hardware));
}

}  // namespace lithe::hal
