// SPDX-License-Identifier: Apache-2.0
// Receiving side of the driver: frames from the drive.
#include <array>
#include <cmath>
#include <utility>

#include "spine/hal/cia402/cia402_drive.hpp"
#include "spine/wire/wire.hpp"

namespace lithe::hal::cia402 {

using canopen::NmtState;
using canopen::SdoClient;

namespace {

constexpr double kMaxRatedTorques = 10;  // plausibility limit: no motor has more

}  // namespace

void Cia402Drive::start_setup() LITHE_RT {
  stage_ = Stage::setup;
  state_ = State::not_ready;
  was_enabled_ = followed_ = false;
  velocity_exchange_ = 0;
  unanswered_ = 0;
  may_enable_ = false;
  units_.begin();
  report_.restart();
  setup_.begin(sdo_);
}

ReplyKind Cia402Drive::on_frame(const Frame& frame, const Exchange& exchange, JointSample& sample) LITHE_RT {
  if (!canopen::is_canopen(frame) || canopen::node_of(frame) != params_.id) return ReplyKind::malformed;
  const std::uint32_t function = canopen::function_of(frame);
  if (function == canopen::cob::kHeartbeat) return on_heartbeat(frame, exchange.now_ns);
  if (function == canopen::cob::kEmergency) return on_emergency(frame);
  if (function == canopen::cob::kSdoAnswer) return on_sdo(frame);
  if (frame.id == pdo::transmit_id(pdo::kVelocity, params_.id)) return on_velocity(frame, exchange);
  if (frame.id == pdo::transmit_id(pdo::kAnswer, params_.id)) return on_answer(frame, exchange, sample);
  return ReplyKind::malformed;
}

ReplyKind Cia402Drive::on_heartbeat(const Frame& frame, std::int64_t now_ns) LITHE_RT {
  NmtState state{};
  if (!canopen::parse_heartbeat(frame, state)) return ReplyKind::malformed;
  heartbeat_.received(now_ns);
  const bool was_silent = std::exchange(silent_, false);
  doubted_ = (was_silent || doubted_) && state == NmtState::boot_up;
  if (state == NmtState::boot_up) {
    if (stage_ == Stage::running) set_not_ready({NotReadyKind::left_operational, {}, static_cast<std::uint8_t>(state)});
    start_setup();  // it has lost its configuration
    stopped_ = false;
    units_wrong_ = false;
    error_code_ = 0;
    return ReplyKind::part;
  }
  // It still sends heartbeats: it did not get the reset.
  if (stage_ == Stage::await_boot_up && now_ns - reset_ns_ >= kResetNs) stage_ = Stage::reset;
  if (stage_ != Stage::running) return ReplyKind::part;
  if (state == NmtState::operational) {
    if (was_silent && !units_wrong_) set_not_ready({});
    if (last_action_ == DriveAction::off) forgive();
    return ReplyKind::part;
  }
  start_setup();
  watchdog_ = true;  // it does this by itself only when it loses our heartbeat; we may have missed its EMCY frame
  stopped_ = state == NmtState::stopped;
  set_not_ready({NotReadyKind::left_operational, {}, static_cast<std::uint8_t>(state)});
  return ReplyKind::part;
}

ReplyKind Cia402Drive::on_emergency(const Frame& frame) LITHE_RT {
  canopen::Emergency what;
  if (!canopen::parse_emergency(frame, what)) return ReplyKind::malformed;
  if (what.code == canopen::emergency::kHeartbeatLost) {
    watchdog_ = true;
    may_enable_ = false;
  }
  error_code_ = what.code;
  return ReplyKind::part;
}

ReplyKind Cia402Drive::on_sdo(const Frame& frame) LITHE_RT {
  if (!sdo_.on_frame(frame)) return ReplyKind::late;
  const SdoClient::Outcome outcome = sdo_.outcome();
  const bool over = outcome == SdoClient::Outcome::done || outcome == SdoClient::Outcome::failed;
  if (stage_ != Stage::running || !over || report_.on_answer(sdo_)) return ReplyKind::part;
  if (outcome == SdoClient::Outcome::done) error_code_ = static_cast<std::uint16_t>(sdo_.value());
  return ReplyKind::part;
}

ReplyKind Cia402Drive::on_velocity(const Frame& frame, const Exchange& exchange) LITHE_RT {
  std::array<std::uint32_t, 1> raw{};
  if (!velocity_map_.unpack(frame, raw)) return ReplyKind::malformed;
  velocity_raw_ = canopen::signed_of(raw[0], 4);
  velocity_exchange_ = exchange.number;
  return ReplyKind::part;
}

ReplyKind Cia402Drive::on_answer(const Frame& frame, const Exchange& exchange, JointSample& sample) LITHE_RT {
  std::array<std::uint32_t, 3> raw{};
  State state{};
  if (!answer_map_.unpack(frame, raw)) return ReplyKind::malformed;
  const auto word = static_cast<std::uint16_t>(raw[0]);
  if (!decode_state(word, state)) return ReplyKind::malformed;
  // The frame has no SYNC number. Frames received before this exchange's SYNC, or in an exchange without one, answer an
  // older SYNC.
  if (!exchange.asked || commanded_ != exchange.number) return ReplyKind::late;
  note_state(state, (word & status_bit::kFollows) != 0);
  position_raw_ = raw[1];
  if (stage_ != Stage::running || !told_) return ReplyKind::part;
  const bool heard = velocity_exchange_ > 0 && exchange.number - velocity_exchange_ <= kVelocityAge * params_.divider;
  last_.measured = measure(canopen::signed_of(raw[1], 4), canopen::signed_of(raw[2], 2)) && heard;
  if (last_.measured) {
    unanswered_ = 0;
    check_units(exchange.now_ns);
  }
  last_.status = status();
  last_.drive = report();
  sample = last_;
  return ReplyKind::answer;
}

// An implausible value is not a measurement: neither the samples nor our own control loop may use it.
bool Cia402Drive::measure(std::int32_t position_raw, std::int32_t torque_raw) LITHE_RT {
  const double motor_rev = position_raw / params_.counts_per_rev;
  const double motor_rev_s = velocity_raw_ / params_.counts_per_rev;
  const double rated_torques = torque_raw / 1000.0;
  if (std::abs(motor_rev_s) > kMaxMotorRevPerS || std::abs(rated_torques) > kMaxRatedTorques) return false;
  last_.position_rad = params_.joint.position_rad(motor_rev);
  last_.velocity_rad_s = motor_rev_s / params_.joint.rev_per_rad();
  last_.torque_nm = rated_torques * params_.rated_torque_nm * params_.joint.gear();
  return true;
}

void Cia402Drive::note_state(State state, bool follows) LITHE_RT {
  // The emergency that clears an error may be lost, or never be sent.
  if (state_ == State::fault && state != State::fault) error_code_ = 0;
  state_ = state;
  if (stage_ != Stage::running || last_action_ != DriveAction::torque || last_control_ != control::kEnable) return;
  const bool enabled = state == State::operation_enabled;
  const bool left = was_enabled_ && !enabled;
  const bool let_go = enabled && followed_ && !follows;  // not every drive has this bit
  was_enabled_ = was_enabled_ || enabled;
  followed_ = enabled && follows;
  if (left || let_go) drop({NotReadyKind::left_enabled, {object::kStatusword, 0}, static_cast<std::uint8_t>(state)});
}

void Cia402Drive::check_units(std::int64_t now_ns) LITHE_RT {
  if (units_wrong_ || units_.agrees(now_ns, static_cast<std::int32_t>(position_raw_), velocity_raw_)) return;
  units_wrong_ = true;
  const auto ratio = static_cast<std::int32_t>(std::round(1000 * units_.ratio()));
  drop({NotReadyKind::velocity_unit, {object::kVelocity, 0}, static_cast<std::uint32_t>(ratio)});
}

bool Cia402Drive::failed() const LITHE_RT {
  return state_ == State::fault || state_ == State::fault_reaction_active || dropped_;
}

std::uint32_t Cia402Drive::status() const LITHE_RT {
  std::uint32_t error_class = error_code_ >> 8;
  if (failed() && error_class == 0) error_class = 0xff;
  std::uint32_t status = error_class << 8 | std::uint32_t{static_cast<std::uint8_t>(state_)} << 16;
  if (failed()) status |= wire::joint_status::kFault;
  if (watchdog_) status |= wire::joint_status::kWatchdog;
  if (silent_) status |= wire::joint_status::kNotReady;  // it could not be enabled
  return status;
}

DriveReport Cia402Drive::report() const LITHE_RT {
  wire::DriveState state = wire::DriveState::off;
  if (state_ == State::ready_to_switch_on || state_ == State::switched_on) state = wire::DriveState::enabling;
  if (state_ == State::operation_enabled) state = wire::DriveState::driven;
  // `fault` is said of a motor without power. On its ramp, or not stopped yet, a drive with a fault has power.
  const bool ramp = state_ == State::quick_stop_active || state_ == State::fault_reaction_active;
  if (ramp) state = wire::DriveState::damped;
  if (failed() && !ramp && state_ != State::operation_enabled) state = wire::DriveState::fault;
  const double sign = params_.joint.gear() < 0 ? -1 : 1;
  DriveReport report;
  report.state = state;
  report.current_a = sign * report_.current_a();
  report.voltage_v = report_.voltage_v();
  return report;
}

}  // namespace lithe::hal::cia402
