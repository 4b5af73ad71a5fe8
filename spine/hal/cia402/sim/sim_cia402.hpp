// SPDX-License-Identifier: Apache-2.0
// A simulated CANopen drive of profile CiA 402 at the far end of a bus: same frames as a real drive.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <string_view>

#include "spine/core/rt.hpp"
#include "spine/hal/bus/loop/loop_bus.hpp"
#include "spine/hal/canopen/canopen.hpp"
#include "spine/hal/canopen/canopen_pdo.hpp"
#include "spine/hal/cia402/sim/cia402_dictionary.hpp"
#include "spine/hal/cia402/sim/cia402_servo.hpp"
#include "spine/hal/core/frame.hpp"
#include "spine/hal/physics/coupled_drive.hpp"

namespace lithe::hal::sim {

struct SimCia402Params {
  std::uint32_t id = 1;                     // 1 to 126
  std::uint32_t device_type = 0x0002'0192;  // object 1000h
  std::int64_t boot_ns = 2'000'000;         // from power-on or reset to the boot-up message
  // Requirements of some drives: TPDO ids with the "no remote frames" bit; no writes to limits, options and mappings
  // while the motor is on.
  bool knows_no_remote = false;
  bool refuses_while_on = false;
  Cia402ServoParams servo;
  JointTransform joint;
  PlantParams plant;
  DriveErrors errors{};
};

// The four PDOs of one direction, from their objects. Rebuilt when those are written.
class SimPdo {
 public:
  bool valid() const LITHE_RT { return valid_; }
  std::uint32_t id() const LITHE_RT { return id_; }
  const canopen::PdoMap& map() const LITHE_RT { return map_; }
  Cia402Dictionary::Slot slot(std::size_t number) const LITHE_RT { return slots_[number]; }
  // At a SYNC (types 0 to 240), or at once (254, 255).
  bool synchronous() const LITHE_RT { return type_ <= 240; }
  bool every(std::uint32_t syncs) const LITHE_RT { return type_ > 0 && syncs % type_ == 0; }

  void rebuild(const Cia402Dictionary& dictionary, std::uint16_t communication, std::uint16_t mapping) LITHE_RT;

  Frame waiting;  // an RPDO until its SYNC
  bool has_waiting = false;
  std::uint32_t told = 0;  // last sent statusword; a change triggers an event-driven TPDO
  bool never_told = true;
  std::int64_t told_ns = 0;

 private:
  bool valid_ = false;
  std::uint32_t id_ = 0;
  std::uint8_t type_ = 255;
  canopen::PdoMap map_;
  std::array<Cia402Dictionary::Slot, canopen::PdoMap::kMost> slots_{};
};

// As CiA 301 and 402 have it: network states, SDO server (expedited, segmented upload), PDOs that can be remapped while
// they are off, heartbeats both ways, emergencies. When the heartbeat that object 1016h names stops, it does what
// object 6007h says and falls back to pre-operational (1029h). Not simulated: block and segmented download, node
// guarding, inhibit times, profile modes, homing.
// Contract: RT but for the constructor · one thread · time comes from frames and on_time()
class SimCia402 final : public BusNode, private SdoServer {
 public:
  explicit SimCia402(const SimCia402Params& params);

  void on_frame(const Frame& frame, std::int64_t now_ns, FrameQueue& answers) LITHE_RT override;
  void on_time(std::int64_t now_ns, FrameQueue& answers) LITHE_RT override { live(now_ns, answers); }

  // Injects a fault whose cause stays; inject(0) ends all.
  void inject(std::uint16_t code) LITHE_RT;
  bool inject(InjectedFault injected, bool begins, std::int64_t now_ns) LITHE_RT override;
  void to_start() LITHE_RT override { servo_.to_start(); }

  Cia402Servo& servo() LITHE_RT { return servo_; }
  const Cia402Dictionary& dictionary() const LITHE_RT { return dictionary_; }
  canopen::NmtState network_state() const LITHE_RT { return network_state_; }
  std::uint64_t refused() const LITHE_RT { return refused_; }  // invalid frames to it

 private:
  static constexpr std::size_t kPdos = 4;

  bool cause(std::uint16_t code, bool begins) LITHE_RT;
  void live(std::int64_t now_ns, FrameQueue& answers) LITHE_RT;
  void reset(bool all) LITHE_RT;
  void boot(FrameQueue& answers) LITHE_RT;
  void lose_connection(FrameQueue& answers) LITHE_RT;
  void tell_news(std::int64_t now_ns, FrameQueue& answers) LITHE_RT;
  void tell_emergency(std::uint16_t code, FrameQueue& answers) LITHE_RT;

  void on_nmt(const Frame& frame) LITHE_RT;
  void hear_heartbeat(const Frame& frame, std::int64_t now_ns, FrameQueue& answers) LITHE_RT;
  std::uint32_t read_object(Cia402Dictionary::Slot slot) LITHE_RT override;
  std::uint32_t write_object(Cia402Dictionary::Slot slot, std::uint32_t value) LITHE_RT override;
  std::string_view text(canopen::Address address) const LITHE_RT override { return Cia402Dictionary::text(address); }
  std::uint32_t write_pdo(canopen::Address address, std::uint32_t value) LITHE_RT;
  bool is_settled(std::uint16_t index) const LITHE_RT;
  std::uint32_t check_mapping(canopen::Address count, std::uint32_t value) const LITHE_RT;
  void written(canopen::Address address) LITHE_RT;
  void rebuild_pdos() LITHE_RT;
  void refresh_inputs() LITHE_RT;
  void refresh_actuals() LITHE_RT;

  void sync(std::int64_t now_ns, FrameQueue& answers) LITHE_RT;
  void on_pdo(const Frame& frame, FrameQueue& answers) LITHE_RT;
  void apply(const SimPdo& pdo, const Frame& frame) LITHE_RT;
  void transmit(SimPdo& pdo, std::int64_t now_ns, FrameQueue& answers) LITHE_RT;

  SimCia402Params params_;
  Cia402Dictionary dictionary_;
  Cia402Servo servo_;
  canopen::NmtState network_state_ = canopen::NmtState::boot_up;
  canopen::HeartbeatProducer producer_;
  canopen::HeartbeatConsumer consumer_;
  std::array<SimPdo, kPdos> receive_;
  std::array<SimPdo, kPdos> transmit_;

  bool booting_ = true;
  std::int64_t boot_end_ns_ = kUnknown;
  std::int64_t now_ns_ = 0;
  std::uint32_t syncs_ = 0;
  std::uint32_t errors_told_ = 0;
  bool connection_lost_ = false;
  bool host_silent_ = false;  // as after a heartbeat timeout of the host
  bool other_map_ = false;    // other PDO mapping and another device type

  static constexpr std::int64_t kUnknown = std::numeric_limits<std::int64_t>::max();
};

// Of a robot file.
SimDevice make_sim_cia402(const SimPlace& place);
double cia402_torque_max_nm(const robot::DeviceConfig& device);

}  // namespace lithe::hal::sim
