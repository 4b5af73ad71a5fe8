// SPDX-License-Identifier: Apache-2.0
// Implements hal::Drive for a CiA 402 drive.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <string_view>

#include "spine/core/rt.hpp"
#include "spine/hal/canopen/canopen.hpp"
#include "spine/hal/canopen/canopen_pdo.hpp"
#include "spine/hal/canopen/canopen_sdo.hpp"
#include "spine/hal/cia402/cia402.hpp"
#include "spine/hal/cia402/cia402_report.hpp"
#include "spine/hal/cia402/cia402_setpoint_limiter.hpp"
#include "spine/hal/cia402/cia402_setup.hpp"
#include "spine/hal/cia402/cia402_unit_check.hpp"
#include "spine/hal/core/bus_tools.hpp"
#include "spine/hal/core/drive.hpp"
#include "spine/robot/config.hpp"

namespace lithe::hal::cia402 {

// Resets the drive, sets it up (Setup), and commands it from then on with one RPDO per exchange; the SYNC that follows
// (CanopenMaster) makes it apply that and answer. Until it is set up its joint is not fresh.
//
//   action    control word                       joint_status
//   torque    06, 07, 0F; then targets count     mode   the state, as cia402::State
//   damp      02: quick stop, then off           fault  class of the error: the high byte of its code (23 current,
//   brake     00: off; the drive's own brake            31-33 voltage, 42 heat, 73 sensor, 81 bus, 86 following);
//   off       00                                        FF: a fault without a code, or one that the driver sees
//
// Nothing but `off` followed by `torque` enables a drive again after a fault (which is reset on that edge only), a
// restart, or any of these, which the driver reports as a fault and answers with a quick stop:
//   - it left `operation enabled`, or stopped following its target, without a command to do so: safe torque off (STO),
//     a limit switch, an enable input. Otherwise the motor would start by itself when that input is released.
//   - it did not reach `operation enabled` within kEnableNs, also out of a fault: the request timed out and is dropped
//   - its heartbeat is lost. While it is off and still sends none, it is reset and set up again, at most every kBootNs.
//     It is not ready until a heartbeat is received
//   - it is a torque drive, and so many of its answers are missing that its joint is lost: its PD loop is closed here
//     (SetpointLimiter), and with an old sample that would be a constant torque
//   - its velocity contradicts its position (UnitCheck): a fault until it restarts. Off with clear_fault resets it
// Off with clear_fault also resets a drive whose set-up failed, and sets it up again. Position and velocity drives have
// their own control loops and gains.
// Contract: as hal::Drive; why_not_ready() any thread, never in an exchange's
class Cia402Drive final : public Drive {
 public:
  static constexpr std::int64_t kEnableNs = 5'000'000'000;

  explicit Cia402Drive(const DriverParams& params);

  bool command(const JointCommand& command, const Exchange& exchange, Bus& bus) LITHE_RT override;
  ReplyKind on_frame(const Frame& frame, const Exchange& exchange, JointSample& sample) LITHE_RT override;
  // It leaves OPERATIONAL when it loses our heartbeat, and then answers nothing.
  std::uint32_t alarm() const LITHE_RT override { return watchdog_ ? wire::joint_status::kWatchdog : 0; }

  // Empty when the drive can be commanded.
  std::string why_not_ready() const override;
  bool running() const LITHE_RT { return stage_ == Stage::running; }

 private:
  enum class Stage : std::uint8_t { reset, await_boot_up, setup, running, refused };

  static constexpr std::int64_t kBootNs = 5'000'000'000;
  // A heartbeat this long after a reset: the drive did not receive the reset.
  static constexpr std::int64_t kResetNs = 200'000'000;
  static constexpr std::uint64_t kVelocityAge = 2;  // commands for which a velocity may stand in for a lost one

  void forgive() LITHE_RT;
  void reset_if_needed(const JointCommand& command, DriveAction action, std::int64_t now_ns) LITHE_RT;
  void drop(const NotReadyReason& why) LITHE_RT;
  void watch(const Exchange& exchange) LITHE_RT;
  void watch_enabling(DriveAction action, std::int64_t now_ns) LITHE_RT;
  void progress(const Exchange& exchange, Bus& bus) LITHE_RT;
  bool reset_node(std::int64_t now_ns, Bus& bus) LITHE_RT;
  void start_setup() LITHE_RT;
  void set_not_ready(const NotReadyReason& not_ready, std::uint64_t lacks = 0) LITHE_RT;
  void say(const JointCommand& command, DriveAction action, Bus& bus) LITHE_RT;
  void ask(std::int64_t now_ns, Bus& bus) LITHE_RT;
  std::uint16_t control_word(DriveAction action) LITHE_RT;
  std::uint16_t clearing_word() LITHE_RT;

  ReplyKind on_heartbeat(const Frame& frame, std::int64_t now_ns) LITHE_RT;
  ReplyKind on_emergency(const Frame& frame) LITHE_RT;
  ReplyKind on_sdo(const Frame& frame) LITHE_RT;
  ReplyKind on_velocity(const Frame& frame, const Exchange& exchange) LITHE_RT;
  ReplyKind on_answer(const Frame& frame, const Exchange& exchange, JointSample& sample) LITHE_RT;
  bool measure(std::int32_t position_raw, std::int32_t torque_raw) LITHE_RT;
  void note_state(State state, bool follows) LITHE_RT;
  void check_units(std::int64_t now_ns) LITHE_RT;
  bool failed() const LITHE_RT;
  std::uint32_t status() const LITHE_RT;
  DriveReport report() const LITHE_RT;

  DriverParams params_;
  canopen::PdoMap command_map_;
  canopen::PdoMap velocity_map_ = pdo::velocity_map();
  canopen::PdoMap answer_map_ = pdo::answer_map();
  canopen::SdoClient sdo_;
  Setup setup_;
  SetpointLimiter limiter_;
  UnitCheck units_;
  ReportClient report_;
  canopen::HeartbeatConsumer heartbeat_;
  std::int64_t silence_ns_;  // without a heartbeat

  Stage stage_ = Stage::reset;
  std::int64_t reset_ns_ = 0;  // when it was told to reset
  bool reset_after_refusal_ = false;
  bool stopped_ = false;  // its network state: it answers no SDO
  std::int64_t silent_from_ns_ = 0;
  bool silent_ = false;        // no heartbeat
  bool doubted_ = false;       // it was silent, and only its boot-up message was received since
  bool clearing_off_ = false;  // the last command was `off` with clear_fault
  bool may_enable_ = true;     // false until `off` is commanded
  bool dropped_ = false;       // reported as a fault until then
  bool watchdog_ = false;      // it has lost our heartbeat; latched until `off`
  bool units_wrong_ = false;   // until it restarts

  DriveAction last_action_ = DriveAction::off;
  std::uint16_t last_control_ = 0;
  bool told_ = false;             // the bus accepted the last command
  std::uint64_t commanded_ = 0;   // exchange in which it was commanded last
  std::uint32_t unanswered_ = 0;  // commands since the last whole answer
  std::int64_t enabling_from_ns_ = 0;
  bool resetting_ = false;      // a fault, since `torque` followed `off`
  std::uint32_t clearing_ = 0;  // commands that were to clear a fault

  State state_ = State::not_ready;
  bool was_enabled_ = false;  // since `torque` is commanded
  bool followed_ = false;     // and followed its target
  std::uint16_t error_code_ = 0;
  bool asked_why_ = false;  // once per fault
  std::uint32_t position_raw_ = 0;
  std::int32_t velocity_raw_ = 0;
  std::uint64_t velocity_exchange_ = 0;  // in which it came; 0: never
  JointSample last_;

  // Both stored by the exchange's thread, loaded by any.
  std::atomic<std::uint64_t> not_ready_{};  // NotReadyReason::packed()
  std::atomic<std::uint64_t> lacks_{};      // Setup::lacks(), of the same reason
};

// Of a robot file: what the registry's row needs of it.
DriverParams params_of(const robot::RobotConfig& robot, const robot::JointConfig& joint);
std::unique_ptr<Drive> make_drive(const robot::RobotConfig& robot, const robot::JointConfig& joint);
// Reads what the set-up would write, and changes nothing: why the drive would not do; empty = nothing is known.
std::string look(const robot::RobotConfig& robot, const robot::DeviceConfig& device, const AskedBus& line);
// SYNC and our heartbeat, for all drives of the bus.
std::unique_ptr<BusMaster> make_master(const robot::RobotConfig& robot, std::size_t bus);
// One SYNC asks all drives of the bus, and each answers every SYNC.
PlannedFrames planned_frames(const robot::DeviceConfig& device, const robot::BusConfig& bus);
PlannedFrames bus_frames(const robot::RobotConfig& robot, std::size_t bus);

// For example "fault: too hot (42xxh)".
std::string state_words(std::uint32_t state, std::uint32_t error_class);
bool process_map(const robot::DeviceConfig& device, std::uint32_t id, canopen::PdoMap& map);
std::string process_value(const canopen::Mapped& mapped, std::uint32_t raw);
std::string_view object_name(std::uint16_t index);

}  // namespace lithe::hal::cia402
