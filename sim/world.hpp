// SPDX-License-Identifier: Apache-2.0
// The simulated hardware of one robot: its buses with their devices and outer ends.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "sim/devices.hpp"
#include "sim/end.hpp"
#include "sim/fault_request.hpp"
#include "spine/core/result.hpp"
#include "spine/robot/config.hpp"

namespace lithe::simulator {

struct Options {
  std::string link_folder;  // links BUS -> terminal; empty = none
  std::uint64_t seed = 1;   // of all random faults
};

// Contract: not RT · one thread · times are CLOCK_MONOTONIC [ns]
class World {
 public:
  // `say` gets one line for each bus, now and whenever it has a new place: "NAME KIND PLACE".
  using Say = std::function<void(const std::string&)>;
  static Result<std::unique_ptr<World>> open(const robot::RobotConfig& config, const Options& options, Say say);

  // Applies an order now, or schedules it. The error: no such bus or device, or it does not have this fault.
  Result<> handle(const FaultRequest& order, std::int64_t now_ns);

  // Advances time: devices send by themselves, scheduled orders are applied. Call about once a millisecond.
  void tick(std::int64_t now_ns);

  const std::vector<std::unique_ptr<End>>& ends() const { return ends_; }

 private:
  struct Line {
    std::string name;
    std::string kind;
    bool in_kernel = false;  // an interface; no program can unplug it
    std::string place;       // as last printed
  };
  struct Due {
    std::int64_t at_ns;
    FaultRequest order;
  };

  Result<> add_bus(const robot::RobotConfig& config, std::size_t index, const Options& options);
  Result<> check(const FaultRequest& order) const;
  void act(const FaultRequest& order, std::int64_t now_ns);
  void tell_places();

  Say say_;
  std::unique_ptr<Devices> devices_;
  std::vector<Line> lines_;
  std::vector<std::unique_ptr<End>> ends_;  // as lines_
  std::vector<Due> due_;
};

}  // namespace lithe::simulator
