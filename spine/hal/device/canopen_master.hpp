// SPDX-License-Identifier: Apache-2.0
// What a CANopen line needs beside the commands to its drives.
#pragma once

#include <cstdint>

#include "spine/core/rt.hpp"
#include "spine/hal/device/canopen.hpp"
#include "spine/hal/device/drive.hpp"

namespace lithe::hal::canopen {

// Of ours, in the shortest watchdog of the line: two in a row may be lost.
inline constexpr double kHeartbeatsPerWatchdog = 4;

struct MasterParams {
  std::uint32_t node = 127;    // our own address
  double heartbeat_s = 0.025;  // the shortest watchdog of the line / kHeartbeatsPerWatchdog, or less
  std::uint32_t divider = 1;   // its drives are asked, all of them, in exchanges whose number this divides
};

// Our heartbeat, by which the drives know that somebody commands them: from the thread that commands, so that it stops
// with it. And one SYNC behind the last command of every exchange in which the drives are asked: they apply what they
// were told and sample, together. They do both at every SYNC, whoever was told what: so the drives of a line share one
// divider. The network state of a drive is its driver's business: each starts and restarts on its own.
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
