// SPDX-License-Identifier: Apache-2.0
// A simulated CANopen module of profile CiA 401 with digital and analog inputs: same frames as a real one.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "spine/core/rt.hpp"
#include "spine/hal/bus/loop/loop_bus.hpp"
#include "spine/hal/canopen/canopen.hpp"
#include "spine/hal/canopen/sim_objects.hpp"
#include "spine/hal/cia401/cia401.hpp"
#include "spine/hal/physics/coupled_drive.hpp"

namespace lithe::hal::sim {

// Its inputs: analog channel c swings as 1000 * sin(2 pi t + c) counts, digital channel c blinks with 2^c periods per
// minute. It knows network states, SDO (expedited), TPDOs that can be remapped while they are off and are sent when
// their event timer ends, and its heartbeat. Not simulated: events on a change, SYNC, emergencies, outputs.
// Contract: RT but for the constructor · one thread · time comes from frames and on_time()
class SimCia401 final : public BusNode, private SdoServer {
 public:
  static constexpr std::int64_t kBootNs = 2'000'000;
  static constexpr std::int64_t kPowerLossNs = 100'000'000;

  SimCia401(std::uint32_t node, const cia401::Inputs& inputs);

  void on_frame(const Frame& frame, std::int64_t now_ns, FrameQueue& answers) LITHE_RT override;
  void on_time(std::int64_t now_ns, FrameQueue& answers) LITHE_RT override;
  bool inject(InjectedFault injected, bool begins, std::int64_t now_ns) LITHE_RT override;

  canopen::NmtState state() const LITHE_RT { return state_; }
  // For tests: stops sending; leaves `operational` by itself.
  void mute(bool muted) LITHE_RT { muted_ = muted; }
  void fall_back(canopen::NmtState state) LITHE_RT { state_ = state; }
  const ObjectDictionary& objects() const LITHE_RT { return objects_; }

 private:
  void restart(std::int64_t back_ns) LITHE_RT;
  void handle(const Frame& frame, std::int64_t now_ns) LITHE_RT;
  std::uint32_t read_object(ObjectDictionary::Slot slot) LITHE_RT override { return objects_.raw(slot); }
  std::uint32_t write_object(ObjectDictionary::Slot slot, std::uint32_t value) LITHE_RT override;
  void send_inputs(std::size_t pdo, std::int64_t now_ns, FrameQueue& answers) LITHE_RT;
  std::uint32_t input(canopen::Address address, std::int64_t now_ns) const LITHE_RT;

  std::uint32_t node_;
  ObjectDictionary objects_;
  canopen::NmtState state_ = canopen::NmtState::boot_up;
  canopen::HeartbeatProducer heartbeat_;
  std::int64_t boot_ns_ = 0;  // 0: not known yet
  std::int64_t start_ns_ = 0;
  std::array<std::int64_t, cia401::kPdos> sent_ns_{};
  bool muted_ = false;
  bool other_map_ = false;  // its process data is shorter than mapped
};

SimDevice make_sim_cia401(const SimPlace& place);

}  // namespace lithe::hal::sim
