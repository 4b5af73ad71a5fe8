// SPDX-License-Identifier: Apache-2.0
// The simulated devices of one robot and the wires to them, and what befalls them on order.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "sim/order.hpp"
#include "spine/core/result.hpp"
#include "spine/hal/bus/loop/loop_bus.hpp"
#include "spine/hal/sim/nodes.hpp"
#include "spine/hal/bus/loop/sim_wire.hpp"
#include "spine/robot/config.hpp"

namespace lithe::simulator {

// Contract: not RT, but for what passes over a wire · one thread · times are CLOCK_MONOTONIC [ns]
class Devices {
 public:
  // `seed`: of everything that befalls frames by chance. The error: what the joints are to move cannot be had.
  static Result<std::unique_ptr<Devices>> make(const robot::RobotConfig& config, std::uint64_t seed);

  hal::sim::SimWire& wire(std::size_t bus) { return *wires_[bus]; }

  // The error: no such bus or device, or nothing of the kind can happen to it.
  Result<> check(const Order& order) const;

  // One that was checked; now, whatever it says of time. Unplugging is not for devices.
  void act(const Order& order, std::int64_t now_ns);

 private:
  // What stands on a device's wire beside it.
  struct Company {
    std::unique_ptr<hal::BusNode> stranger;  // another one, which has its id or stands in for it
    bool here = true;                        // the wire reaches the device itself
  };

  void suffer(std::size_t device, const Order& order, std::int64_t now_ns);
  void meet_stranger(std::size_t device, const Order& order);
  void spoil(const Order& order, std::size_t bus);
  void clear(std::int64_t now_ns);

  robot::RobotConfig config_;
  hal::sim::Nodes nodes_;
  std::vector<Company> company_;                           // as RobotConfig::devices
  std::vector<std::unique_ptr<hal::sim::SimWire>> wires_;  // by bus
};

}  // namespace lithe::simulator
