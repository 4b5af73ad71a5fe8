// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/sim/simulate.hpp"

#include <algorithm>
#include <cstdint>
#include <utility>

#include "spine/hal/bus/loop/loop_bus.hpp"
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

class LoopSimulation final : public Simulation {
 public:
  explicit LoopSimulation(Nodes nodes) : nodes_(std::move(nodes)) {}

  std::unique_ptr<Bus> open_bus(const robot::RobotConfig& config, std::size_t index) override {
    auto bus = std::make_unique<LoopBus>();
    nodes_.attach(config, index, *bus);
    return bus;
  }
  ImuSource& imu() override { return imu_; }
  void to_start() LITHE_RT override { nodes_.to_start(); }

 private:
  Nodes nodes_;
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
