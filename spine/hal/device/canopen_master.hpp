// SPDX-License-Identifier: Apache-2.0
// What a CANopen line needs beside the commands to its drives.
#pragma once

#include <cstdint>

#include "spine/core/rt.hpp"
#include "spine/hal/device/canopen.hpp"
#include "spine/hal/device/drive.hpp"

namespace lithe::hal::canopen {

// Of our own heartbeat, in the shortest watchdog of the line: a drive stops when it misses all of them.
inline constexpr double kHeartbeatsPerWatchdog = 4;

struct MasterParams {
  std::uint32_t node = 127;    // our own address
  double heartbeat_s = 0.025;  // the shortest watchdog / kHeartbeatsPerWatchdog
};

// Our heartbeat, by which the drives know that somebody commands them: from the thread that commands, so that it stops
// with it. And one SYNC per exchange behind the last command: the drives apply what they were told and sample,
// together. The network state of a drive is its driver's business: each starts and restarts on its own. Contract: as
// hal::BusMaster
class CanopenMaster final : public BusMaster {
 public:
  explicit CanopenMaster(const MasterParams& params)
      : node_(params.node), heartbeat_(static_cast<std::int64_t>(1e9 * params.heartbeat_s)) {}

  void before_commands(const Exchange& exchange, Bus& bus) LITHE_RT override {
    if (heartbeat_.due(exchange.now_ns)) bus.send(heartbeat_frame(node_, NmtState::operational));
  }
  void after_commands(const Exchange&, Bus& bus) LITHE_RT override { bus.send(sync_frame()); }

 private:
  std::uint32_t node_;
  HeartbeatProducer heartbeat_;
};

}  // namespace lithe::hal::canopen
