// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/sim/simulate.hpp"

#include <algorithm>
#include <cstdint>
#include <string>
#include <utility>

#include "spine/hal/sim/nodes.hpp"

namespace lithe::hal::sim {
namespace {

// Level and at rest.
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

// `far_ends` replace the devices of the robot file; empty: they do not.
class LoopSimulation final : public Simulation {
 public:
  LoopSimulation(Nodes nodes, std::vector<BusNode*> far_ends)
      : nodes_(std::move(nodes)), far_ends_(std::move(far_ends)) {}

  std::unique_ptr<Bus> open_bus(const robot::RobotConfig& config, std::size_t index) override {
    auto bus = std::make_unique<LoopBus>();
    if (far_ends_.empty()) {
      nodes_.attach(config, index, *bus);
    } else {
      bus->attach(*far_ends_[index]);
    }
    return bus;
  }
  ImuSource& imu() override { return imu_; }
  void to_start() LITHE_RT override { nodes_.to_start(); }

 private:
  Nodes nodes_;
  std::vector<BusNode*> far_ends_;
  LevelImu imu_;
};

}  // namespace

Result<std::unique_ptr<Simulation>> make_simulation(const robot::RobotConfig& config) {
  const auto real = std::find_if(config.buses.begin(), config.buses.end(), robot::is_real);
  if (config.plant.kind != robot::PlantKind::independent && real != config.buses.end()) {
    return Error{"[plant] joins all joints, but bus '" + real->name +
                 "' is real and others are simulated; make all of them a \"loop\", or none"};
  }
  Result<Nodes> made = make_nodes(config);
  if (!made) return made.error();
  return std::unique_ptr<Simulation>(std::make_unique<LoopSimulation>(std::move(*made), std::vector<BusNode*>{}));
}

Result<std::unique_ptr<Actuators>> open_actuators(const robot::RobotConfig& config, FrameTap* tap) {
  return hal::open_actuators(config, {.make_simulation = make_simulation, .tap = tap});
}

Result<std::unique_ptr<Actuators>> simulate_actuators(robot::RobotConfig config,
                                                      const std::vector<BusNode*>& far_ends) {
  for (robot::BusConfig& bus : config.buses) bus.kind = robot::BusKind::loop;
  if (far_ends.empty()) return open_actuators(config);
  if (far_ends.size() != config.buses.size()) {
    return Error{config.path + ": " + std::to_string(config.buses.size()) + " buses, but far ends for " +
                 std::to_string(far_ends.size())};
  }
  return hal::open_actuators(
      config, {.make_simulation = [far_ends](const robot::RobotConfig&) -> Result<std::unique_ptr<Simulation>> {
        return std::unique_ptr<Simulation>(std::make_unique<LoopSimulation>(Nodes{}, far_ends));
      }});
}

}  // namespace lithe::hal::sim
