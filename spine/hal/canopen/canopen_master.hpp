// SPDX-License-Identifier: Apache-2.0
// Master of a CANopen bus: heartbeat and SYNC.
#pragma once

#include <cstdint>

#include "spine/core/rt.hpp"
#include "spine/hal/canopen/canopen.hpp"
#include "spine/hal/core/drive.hpp"

namespace lithe::hal::canopen {

// Our heartbeats per shortest watchdog of the bus: two in a row may be lost.
inline constexpr double kHeartbeatsPerWatchdog = 4;

struct MasterParams {
  std::uint32_t node = 127;    // our own address
  double heartbeat_s = 0.025;  // the shortest watchdog of the line / kHeartbeatsPerWatchdog, or less
  std::uint32_t divider = 1;   // all its drives are asked when exchange number % divider is 0
};

// Heartbeat: sent by the thread that commands the drives, so that it stops with that thread. SYNC: one after the last
// command of every exchange in which the drives are asked; all drives then apply their commands and sample at the same
// time. They do this at every SYNC, so the drives of a bus share one rate divider. The driver of each drive handles its
// network state.
// Contract: as hal::BusMaster
class CanopenMaster final : public BusMaster {
 public:
  explicit CanopenMaster(const MasterParams& params)
      : node_(params.node), divider_(params.divider), heartbeat_(static_cast<std::int64_t>(1e9 * params.heartbeat_s)) {}

  void before_commands(const Exchange& exchange, Bus& bus) LITHE_RT override {
    if (heartbeat_.due(exchange.now_ns)) bus.send(heartbeat_frame(node_, NmtState::operational));
  }
  void after_commands(const Exchange& exchange, Bus& bus) LITHE_RT override {
    if (exchange.number % divider_ == 0) bus.send(sync_frame());
  }

 private:
  std::uint32_t node_;
  std::uint32_t divider_;
  HeartbeatProducer heartbeat_;
};

}  // namespace lithe::hal::canopen
