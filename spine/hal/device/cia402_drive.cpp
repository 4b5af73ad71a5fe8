// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/device/cia402_drive.hpp"

#include <algorithm>
#include <cmath>

#include "spine/wire/wire.hpp"

namespace lithe::hal::cia402 {

using canopen::NmtCommand;
using canopen::NmtState;
using canopen::SdoClient;

namespace {

constexpr std::int64_t kNsPerS = 1'000'000'000;
constexpr int kBeatsToLost = 3;
constexpr double kMaxRatedTorques = 10;  // no motor has more, not even for a moment: beyond it an answer is noise

bool finite(const JointCommand& c) LITHE_RT {
  return std::isfinite(c.torque_nm) && std::isfinite(c.velocity_rad_s) && std::isfinite(c.kp_nm_rad) &&
         std::isfinite(c.kd_nm_s_rad) && std::isfinite(c.max_torque_nm) && !std::isinf(c.position_rad);
}

// The nearest number that fits.
std::uint32_t counts(double value) LITHE_RT {
  constexpr double kMost = 2147483647.0;
  return static_cast<std::uint32_t>(static_cast<std::int32_t>(std::round(std::clamp(value, -kMost, kMost))));
}

}  // namespace

Cia402Drive::Cia402Drive(const DriverParams& params)
    : params_(params), command_map_(pdo::command_map(params.mode)), sdo_(params.id), setup_(params) {
  heartbeat_.set_timeout(static_cast<std::int64_t>(kBeatsToLost * params.heartbeat_s * kNsPerS));
  set_trouble({TroubleKind::not_booted, {}, 0});
}

bool Cia402Drive::command(const JointCommand& command, const Exchange& exchange, Bus& bus) LITHE_RT {
  const bool sound = command.action != DriveAction::torque || finite(command);
  const DriveAction action = sound ? command.action : DriveAction::damp;
  commanded_ = exchange.number;
  if (action == DriveAction::off) {
    may_enable_ = true;
    watchdog_ = false;
  }
  if (heartbeat_.lost(exchange.now_ns)) {
    may_enable_ = false;
    if (stage_ == Stage::running) set_trouble({TroubleKind::silent, {}, 0});
  }
  if (stage_ == Stage::running) {
    say(command, action, bus);
    ask_error_code(exchange.now_ns, bus);
  } else {
    progress(exchange, bus);
  }
  last_action_ = action;
  return sound;
}

// One step towards `running`, with one frame at most.
void Cia402Drive::progress(const Exchange& exchange, Bus& bus) LITHE_RT {
  const bool overdue = stage_ == Stage::await_boot_up && exchange.now_ns >= boot_deadline_ns_;
  if (stage_ == Stage::reset || overdue) {
    stage_ = Stage::await_boot_up;
    boot_deadline_ns_ = exchange.now_ns + kBootNs;
    bus.send(canopen::nmt_frame(NmtCommand::reset_node, params_.id));
    return;
  }
  if (stage_ != Stage::setup) return;
  if (stopped_) {
    stopped_ = false;
    bus.send(canopen::nmt_frame(NmtCommand::enter_pre_operational, params_.id));
    return;
  }
  Frame frame;
  switch (setup_.advance(sdo_)) {
    case Setup::Progress::busy:
      if (setup_.next(exchange.now_ns, sdo_, frame)) bus.send(frame);
      return;
    case Setup::Progress::done:
      stage_ = Stage::running;
      set_trouble({});
      return;
    case Setup::Progress::failed:
      set_trouble(setup_.trouble());
      // A drive that is gone may come back as another one; one that said no says it again.
      stage_ = setup_.trouble().kind == TroubleKind::no_answer ? Stage::reset : Stage::refused;
  }
}

void Cia402Drive::start_setup() LITHE_RT {
  stage_ = Stage::setup;
  state_ = State::not_ready;
  velocity_exchange_ = 0;
  may_enable_ = false;
  setup_.begin(sdo_);
}

void Cia402Drive::set_trouble(const Trouble& trouble) LITHE_RT {
  // Relaxed: the word is all there is to it. Pairs with why_not_ready().
  trouble_.store(trouble.packed(), std::memory_order_relaxed);
}

std::string Cia402Drive::why_not_ready() const {
  // Relaxed: pairs with set_trouble().
  return describe(Trouble::unpacked(trouble_.load(std::memory_order_relaxed)));
}

void Cia402Drive::say(const JointCommand& command, DriveAction action, Bus& bus) LITHE_RT {
  const std::uint16_t control = control_word(action);
  const bool active = control == control::kEnable && state_ == State::operation_enabled;
  const double limit_nm = std::max(command.max_torque_nm, 0.0);
  const std::array<std::uint32_t, 3> values{control, target(command, active),
                                            active ? torque_raw(command.torque_nm, limit_nm) : 0};
  // A refusal shows as a missed answer, and is counted by the bus.
  bus.send(command_map_.pack(pdo::command_id(params_.id), values));
}

std::uint16_t Cia402Drive::control_word(DriveAction action) LITHE_RT {
  if (action == DriveAction::damp) return control::kQuickStop;
  if (action != DriveAction::torque) return control::kDisableVoltage;
  if (last_action_ == DriveAction::off) resets_left_ = state_ == State::fault ? kResetExchanges : 0;
  if (state_ != State::fault) resets_left_ = 0;
  if (state_ == State::fault && resets_left_ > 0) {
    --resets_left_;
    return control::kFaultReset;  // its bit rises once: what was said before was `off`
  }
  if (state_ == State::fault || state_ == State::fault_reaction_active) may_enable_ = false;
  return may_enable_ ? control_to_enable(state_) : control::kDisableVoltage;
}

std::uint32_t Cia402Drive::target(const JointCommand& command, bool active) LITHE_RT {
  const double counts_per_rad = params_.joint.rev_per_rad() * params_.counts_per_rev;
  switch (params_.mode) {
    case Mode::position:
      if (!active) {
        target_raw_ = position_raw_;
      } else if (!std::isnan(command.position_rad)) {
        target_raw_ = counts(params_.joint.motor_rev(command.position_rad) * params_.counts_per_rev);
      }
      return target_raw_;
    case Mode::velocity:
      return active ? counts(command.velocity_rad_s * counts_per_rad) : 0;
    case Mode::torque:
    case Mode::none:
      break;
  }
  return active ? torque_raw(closed_loop_nm(command), std::max(command.max_torque_nm, 0.0)) : 0;
}

double Cia402Drive::closed_loop_nm(const JointCommand& command) const LITHE_RT {
  const bool has_position = !std::isnan(command.position_rad);
  const double stiff_nm =
      has_position ? std::max(command.kp_nm_rad, 0.0) * (command.position_rad - last_.position_rad) : 0;
  const double damping_nm = std::max(command.kd_nm_s_rad, 0.0) * (command.velocity_rad_s - last_.velocity_rad_s);
  return command.torque_nm + stiff_nm + damping_nm;
}

// Thousandths of the motor's rated torque, as two's complement.
std::uint32_t Cia402Drive::torque_raw(double joint_nm, double limit_nm) const LITHE_RT {
  constexpr double kMost = 32767;
  if (std::isnan(joint_nm)) return 0;  // of terms that are infinite against each other
  const double motor_nm = std::clamp(joint_nm, -limit_nm, limit_nm) / params_.joint.gear();
  const double thousandths = std::round(std::clamp(1000 * motor_nm / params_.rated_torque_nm, -kMost, kMost));
  return static_cast<std::uint16_t>(static_cast<std::int16_t>(thousandths));
}

// The emergency that named the fault may have been lost.
void Cia402Drive::ask_error_code(std::int64_t now_ns, Bus& bus) LITHE_RT {
  if (state_ != State::fault) {
    asked_why_ = false;
  } else if (error_code_ == 0 && !asked_why_) {
    asked_why_ = true;
    sdo_.read({object::kErrorCode, 0});
  }
  Frame frame;
  if (sdo_.next(now_ns, frame)) bus.send(frame);
}

Heard Cia402Drive::take(const Frame& frame, const Exchange& exchange, JointSample& sample) LITHE_RT {
  if (!canopen::is_canopen(frame) || canopen::node_of(frame) != params_.id) return Heard::malformed;
  switch (canopen::function_of(frame)) {
    case canopen::cob::kHeartbeat:
      return take_heartbeat(frame, exchange.now_ns);
    case canopen::cob::kEmergency:
      return take_emergency(frame);
    case canopen::cob::kSdoAnswer:
      return take_sdo(frame);
    default:
      break;
  }
  if (frame.id == pdo::transmit_id(pdo::kVelocity, params_.id)) return take_velocity(frame, exchange);
  if (frame.id == pdo::transmit_id(pdo::kAnswer, params_.id)) return take_answer(frame, exchange, sample);
  return Heard::malformed;
}

Heard Cia402Drive::take_heartbeat(const Frame& frame, std::int64_t now_ns) LITHE_RT {
  NmtState state{};
  if (!canopen::parse_heartbeat(frame, state)) return Heard::malformed;
  heartbeat_.beat(now_ns);
  if (state == NmtState::boot_up) {
    if (stage_ == Stage::running) set_trouble({TroubleKind::left_operational, {}, static_cast<std::uint8_t>(state)});
    start_setup();  // whatever it was told before is forgotten
    stopped_ = false;
    error_code_ = 0;
    return Heard::part;
  }
  if (stage_ != Stage::running) return Heard::part;
  if (state == NmtState::operational) {
    set_trouble({});
    return Heard::part;
  }
  start_setup();
  watchdog_ = true;  // by itself it does this when it hears us no more, and its emergency may have found us deaf
  stopped_ = state == NmtState::stopped;
  set_trouble({TroubleKind::left_operational, {}, static_cast<std::uint8_t>(state)});
  return Heard::part;
}

Heard Cia402Drive::take_emergency(const Frame& frame) LITHE_RT {
  canopen::Emergency what;
  if (!canopen::parse_emergency(frame, what)) return Heard::malformed;
  if (what.code == canopen::emergency::kHeartbeatLost) {
    watchdog_ = true;
    may_enable_ = false;
  }
  error_code_ = what.code;
  return Heard::part;
}

Heard Cia402Drive::take_sdo(const Frame& frame) LITHE_RT {
  if (!sdo_.take(frame)) return Heard::late;
  const bool told = stage_ == Stage::running && sdo_.outcome() == SdoClient::Outcome::done;
  if (told) error_code_ = static_cast<std::uint16_t>(sdo_.value());
  return Heard::part;
}

Heard Cia402Drive::take_velocity(const Frame& frame, const Exchange& exchange) LITHE_RT {
  std::array<std::uint32_t, 1> raw{};
  if (!velocity_map_.unpack(frame, raw)) return Heard::malformed;
  velocity_raw_ = canopen::signed_of(raw[0], 4);
  velocity_exchange_ = exchange.number;
  return Heard::part;
}

Heard Cia402Drive::take_answer(const Frame& frame, const Exchange& exchange, JointSample& sample) LITHE_RT {
  std::array<std::uint32_t, 3> raw{};
  State state{};
  if (!answer_map_.unpack(frame, raw)) return Heard::malformed;
  if (!decode_state(static_cast<std::uint16_t>(raw[0]), state)) return Heard::malformed;
  // Nothing in it tells which SYNC it answers: what is here before ours has left answers an older one. A drive answers
  // every SYNC, also of exchanges in which its joint was not asked and nobody waited for it.
  if (!exchange.asked) return commanded_ + 1 == exchange.number ? Heard::late : Heard::part;
  state_ = state;
  position_raw_ = raw[1];
  if (stage_ != Stage::running) return Heard::part;
  last_.status = status();
  last_.measured = velocity_exchange_ > 0 && exchange.number - velocity_exchange_ <= kVelocityAge;
  measure(canopen::signed_of(raw[1], 4), canopen::signed_of(raw[2], 2));
  sample = last_;
  return Heard::answer;
}

// What no motor does is not measured: neither the map nor our own control loop may believe it.
void Cia402Drive::measure(std::int32_t position_raw, std::int32_t torque_raw) LITHE_RT {
  const double motor_rev = position_raw / params_.counts_per_rev;
  const double motor_rev_s = velocity_raw_ / params_.counts_per_rev;
  const double rated_torques = torque_raw / 1000.0;
  if (std::abs(motor_rev_s) > kMaxMotorRevPerS || std::abs(rated_torques) > kMaxRatedTorques) {
    last_.measured = false;
    return;
  }
  last_.position_rad = params_.joint.position_rad(motor_rev);
  last_.velocity_rad_s = motor_rev_s / params_.joint.rev_per_rad();
  last_.torque_nm = rated_torques * params_.rated_torque_nm * params_.joint.gear();
}

std::uint32_t Cia402Drive::status() const LITHE_RT {
  const bool failed = state_ == State::fault || state_ == State::fault_reaction_active;
  std::uint32_t error_class = error_code_ >> 8;
  if (failed && error_class == 0) error_class = 0xff;
  std::uint32_t status = error_class << 8 | std::uint32_t{static_cast<std::uint8_t>(state_)} << 16;
  if (failed) status |= wire::joint_status::kFault;
  if (watchdog_) status |= wire::joint_status::kWatchdog;
  return status;
}

}  // namespace lithe::hal::cia402
