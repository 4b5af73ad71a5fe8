// SPDX-License-Identifier: Apache-2.0
// A simulated sensor gateway: sends its blocks periodically.
#pragma once

#include <array>
#include <cstdint>

#include "spine/core/rt.hpp"
#include "spine/hal/bus/loop/loop_bus.hpp"
#include "spine/hal/gateway/gateway.hpp"

namespace lithe::hal::sim {

// Its inputs: analog channel c swings as 1000 * sin(2 pi t + c) counts, digital channel c blinks with 2^c periods per
// minute, the IMU stands still and level. One block per period, in turn.
// Contract: RT · one thread · time comes from the frames received and from on_time()
class SimGateway final : public BusNode {
 public:
  // `fd`: whole blocks in one frame; else two channels per frame, as a classic bus carries.
  SimGateway(std::uint32_t node, std::int64_t period_ns, bool fd) : node_(node), period_ns_(period_ns), fd_(fd) {}

  void on_frame(const Frame&, std::int64_t now_ns, FrameQueue& answers) LITHE_RT override { on_time(now_ns, answers); }
  void on_time(std::int64_t now_ns, FrameQueue& answers) LITHE_RT override;
  bool inject(InjectedFault injected, bool begins, std::int64_t now_ns) LITHE_RT override;

  void unplug_input(gateway::Block block, std::size_t channel) LITHE_RT {
    unplugged_[static_cast<std::size_t>(block)] |= 1U << channel;
  }

 private:
  void send(std::int64_t now_ns, FrameQueue& answers) LITHE_RT;
  std::int16_t word(gateway::Block block, std::size_t channel, double time_s) const LITHE_RT;

  std::uint32_t node_;
  std::int64_t period_ns_;
  bool fd_;
  std::int64_t next_ns_ = 0;
  std::int64_t start_ns_ = 0;
  std::uint8_t sequence_ = 0;
  bool other_map_ = false;
  std::uint32_t turn_ = 0;
  std::array<std::uint32_t, gateway::kBlocks> unplugged_{};
};

}  // namespace lithe::hal::sim
