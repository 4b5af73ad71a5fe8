// SPDX-License-Identifier: Apache-2.0
// A CiA 402 drive as the rest of the robot sees it: any drive.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <string>

#include "spine/core/rt.hpp"
#include "spine/hal/device/canopen.hpp"
#include "spine/hal/device/canopen_sdo.hpp"
#include "spine/hal/device/cia402.hpp"
#include "spine/hal/device/cia402_setup.hpp"
#include "spine/hal/device/drive.hpp"

namespace lithe::hal::cia402 {

// Resets the drive, sets it up (Setup), and commands it from then on with one RPDO per exchange; the SYNC that follows
// (CanopenMaster) makes it apply that and answer. Until it is set up its joint is not fresh.
//
//   action    control word                       joint_status
//   torque    06, 07, 0F; then targets count     mode   the state, as cia402::State
//   damp      02: quick stop, then off           fault  class of the error: the high byte of its code (23 current,
//   brake     00: off; the drive's own brake            31-33 voltage, 42 heat, 73 sensor, 81 bus, 86 following);
//   off       00                                        FF: a fault without a code
// After a fault, a lost heartbeat or a restart of the drive nothing but `off` followed by `torque` enables it again;
// a fault is reset on that edge only. Until its target counts it is where the drive is (position), or 0.
//
// A torque drive has no PD loop of its own: it is closed here, on what the drive said last. Position and velocity
// drives have their own, whose gains are theirs; without a position to go to, a position drive holds the last one.
// Contract: as hal::Drive; why_not_ready() any thread, never in an exchange's
class Cia402Drive final : public Drive {
 public:
  explicit Cia402Drive(const DriverParams& params);

  bool command(const JointCommand& command, const Exchange& exchange, Bus& bus) LITHE_RT override;
  Heard take(const Frame& frame, const Exchange& exchange, JointSample& sample) LITHE_RT override;

  // Empty when the drive can be commanded.
  std::string why_not_ready() const;
  bool running() const LITHE_RT { return stage_ == Stage::running; }

 private:
  enum class Stage : std::uint8_t { reset, await_boot_up, setup, running, refused };

  static constexpr std::int64_t kBootNs = 5'000'000'000;
  static constexpr std::uint32_t kResetExchanges = 20;  // for so many a fault reset is held before it has failed
  static constexpr std::uint64_t kVelocityAge = 2;      // exchanges for which a velocity may stand in for a lost one

  void progress(const Exchange& exchange, Bus& bus) LITHE_RT;
  void start_setup() LITHE_RT;
  void set_trouble(const Trouble& trouble) LITHE_RT;
  void say(const JointCommand& command, DriveAction action, Bus& bus) LITHE_RT;
  void ask_error_code(std::int64_t now_ns, Bus& bus) LITHE_RT;
  std::uint16_t control_word(DriveAction action) LITHE_RT;
  std::uint32_t target(const JointCommand& command, bool active) LITHE_RT;
  double closed_loop_nm(const JointCommand& command) const LITHE_RT;
  std::uint32_t torque_raw(double joint_nm, double limit_nm) const LITHE_RT;

  Heard take_heartbeat(const Frame& frame, std::int64_t now_ns) LITHE_RT;
  Heard take_emergency(const Frame& frame) LITHE_RT;
  Heard take_sdo(const Frame& frame) LITHE_RT;
  Heard take_velocity(const Frame& frame, const Exchange& exchange) LITHE_RT;
  Heard take_answer(const Frame& frame, const Exchange& exchange, JointSample& sample) LITHE_RT;
  void measure(std::int32_t position_raw, std::int32_t torque_raw) LITHE_RT;
  std::uint32_t status() const LITHE_RT;

  DriverParams params_;
  canopen::PdoMap command_map_;
  canopen::PdoMap velocity_map_ = pdo::velocity_map();
  canopen::PdoMap answer_map_ = pdo::answer_map();
  canopen::SdoClient sdo_;
  Setup setup_;
  canopen::HeartbeatConsumer heartbeat_;

  Stage stage_ = Stage::reset;
  std::int64_t boot_deadline_ns_ = 0;
  bool stopped_ = false;    // its network state: it answers no SDO
  bool may_enable_ = true;  // false until `off` is commanded
  bool watchdog_ = false;   // it lost our heartbeat; until `off`
  DriveAction last_action_ = DriveAction::off;
  std::uint32_t resets_left_ = 0;

  State state_ = State::not_ready;
  std::uint16_t error_code_ = 0;
  bool asked_why_ = false;  // once per fault
  std::uint32_t position_raw_ = 0;
  std::uint32_t target_raw_ = 0;  // of a position drive
  std::int32_t velocity_raw_ = 0;
  std::uint64_t commanded_ = 0;          // exchange in which it was commanded last
  std::uint64_t velocity_exchange_ = 0;  // in which it came; 0: never
  JointSample last_;

  std::atomic<std::uint64_t> trouble_{};  // Trouble::packed(); stored by the exchange's thread, loaded by any
};

}  // namespace lithe::hal::cia402
