// SPDX-License-Identifier: Apache-2.0
// The simulated devices of one robot, the wires to them, and the faults injected into both.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "sim/fault_request.hpp"
#include "spine/core/result.hpp"
#include "spine/hal/bus/loop/loop_bus.hpp"
#include "spine/hal/bus/loop/sim_wire.hpp"
#include "spine/hal/sim/simulate.hpp"
#include "spine/robot/config.hpp"

namespace lithe::simulator {

// Contract: not RT, except the traffic on a wire · one thread · times are CLOCK_MONOTONIC [ns]
class Devices {
 public:
  // `seed`: of all random faults. The error: the plant cannot be opened.
  static Result<std::unique_ptr<Devices>> make(const robot::RobotConfig& config, std::uint64_t seed);

  hal::sim::SimWire& wire(std::size_t bus) { return *wires_[bus]; }

  // The error: no such bus or device, or it does not have this fault.
  Result<> check(const FaultRequest& order) const;

  // Applies a checked order now, without its times. `unplug` is handled elsewhere.
  void act(const FaultRequest& order, std::int64_t now_ns);

 private:
  // An injected second device on a device's wire (twin or wrong id).
  struct SecondDevice {
    std::unique_ptr<hal::BusNode> second;  // the second device; null = none
    bool here = true;                      // false: the original device is disconnected
  };

  void set_second_device(std::size_t device, const FaultRequest& order);
  void set_wire_fault(const FaultRequest& order, std::size_t bus);
  void clear(std::int64_t now_ns);

  robot::RobotConfig config_;
  hal::sim::Nodes nodes_;
  std::vector<SecondDevice> second_;                       // as RobotConfig::devices
  std::vector<std::unique_ptr<hal::sim::SimWire>> wires_;  // by bus
};

}  // namespace lithe::simulator
