// SPDX-License-Identifier: Apache-2.0
// Sending side of the driver; the receiving side is cia402_answers.cpp.
#include "spine/hal/cia402/cia402_drive.hpp"

#include <array>
#include <cmath>

#include "spine/core/time.hpp"

namespace lithe::hal::cia402 {

using canopen::NmtCommand;

namespace {

constexpr int kHeartbeatsToLost = 3;

bool finite(const JointCommand& c) LITHE_RT {
  return std::isfinite(c.torque_nm) && std::isfinite(c.target_rad_s) && std::isfinite(c.kp_nm_rad) &&
         std::isfinite(c.kd_nm_s_rad) && std::isfinite(c.max_torque_nm) && !std::isinf(c.target_rad);
}

}  // namespace

Cia402Drive::Cia402Drive(const DriverParams& params)
    : params_(params),
      command_map_(pdo::command_map(params.mode)),
      sdo_(params.id),
      setup_(params),
      limiter_(params),
      units_(params.counts_per_rev, params.period_s),
      silence_ns_(static_cast<std::int64_t>(kHeartbeatsToLost * params.heartbeat_s * kNsPerS)) {
  heartbeat_.set_timeout(silence_ns_);
  set_not_ready({NotReadyKind::not_booted, {}, 0});
}

bool Cia402Drive::command(const JointCommand& command, const Exchange& exchange, Bus& bus) LITHE_RT {
  const bool sound = command.action != DriveAction::torque || finite(command);
  const DriveAction action = sound ? command.action : DriveAction::damp;
  commanded_ = exchange.number;
  if (action == DriveAction::off) forgive();
  watch(exchange);
  reset_if_needed(command, action, exchange.now_ns);
  if (stage_ == Stage::running) {
    watch_enabling(action, exchange.now_ns);
    say(command, action, bus);
    ask(exchange.now_ns, bus);
  } else {
    progress(exchange, bus);
  }
  last_action_ = action;
  return sound;
}

void Cia402Drive::forgive() LITHE_RT {
  if (units_wrong_ || silent_) return;  // it would not be supervised
  if (dropped_ && stage_ == Stage::running) set_not_ready({});
  may_enable_ = true;
  dropped_ = false;
  watchdog_ = false;
}

// The drive is not in the commanded state, or must not be: report it as a fault.
void Cia402Drive::drop(const NotReadyReason& why) LITHE_RT {
  set_not_ready(why);
  may_enable_ = false;
  dropped_ = true;
}

// True while the drive is present and in its last reported state.
void Cia402Drive::watch(const Exchange& exchange) LITHE_RT {
  if (stage_ == Stage::running) ++unanswered_;
  if (heartbeat_.lost(exchange.now_ns)) {
    silent_ = true;
    silent_from_ns_ = exchange.now_ns;
    may_enable_ = false;
    if (stage_ == Stage::running) drop({NotReadyKind::silent, {}, 0});
  }
  if (stage_ != Stage::running || unanswered_ <= params_.lost_after_misses) return;
  const bool closes_loop = params_.mode == Mode::torque && last_action_ == DriveAction::torque;
  if (closes_loop && !dropped_) drop({NotReadyKind::unheard, {}, unanswered_});
  // No frame comes from it, and we were not delayed ourselves. It may have restarted, and its boot-up message was lost:
  // then it would stay silent.
  if (silent_ && exchange.now_ns - silent_from_ns_ >= silence_ns_) {
    drop({NotReadyKind::silent, {}, 0});
    stage_ = Stage::reset;
  }
}

// Resets and configures the drive again after a fault that "off" does not clear. Its motor is off. At most once in
// kBootNs, and once for each reset of the robot. Configures it again when its joint is beyond what it may target.
void Cia402Drive::reset_if_needed(const JointCommand& command, DriveAction action, std::int64_t now_ns) LITHE_RT {
  const bool clears = action == DriveAction::off && command.clear_fault;
  const bool asked = clears && !clearing_off_;
  clearing_off_ = clears;
  if (action != DriveAction::off) return;
  // A heartbeat that comes late is no reason yet.
  const bool for_long = silent_ && now_ns - silent_from_ns_ >= silence_ns_ && now_ns - reset_ns_ >= kBootNs;
  const bool stuck = (stage_ == Stage::running && units_wrong_) || stage_ == Stage::refused;
  if ((stage_ == Stage::running && for_long) || (asked && stuck)) stage_ = Stage::reset;
  if (stage_ == Stage::running && last_.measured && setup_.must_move_limits(static_cast<std::int32_t>(position_raw_)))
    start_setup();
}

void Cia402Drive::watch_enabling(DriveAction action, std::int64_t now_ns) LITHE_RT {
  if (action != DriveAction::torque) was_enabled_ = followed_ = resetting_ = false;
  if (action != DriveAction::torque || last_action_ != DriveAction::torque) enabling_from_ns_ = now_ns;
  if (may_enable_ && !was_enabled_ && now_ns - enabling_from_ns_ > kEnableNs)
    drop({NotReadyKind::not_enabled, {object::kStatusword, 0}, static_cast<std::uint8_t>(state_)});
}

// One step towards `running`, with one frame at most.
void Cia402Drive::progress(const Exchange& exchange, Bus& bus) LITHE_RT {
  const bool overdue = stage_ == Stage::await_boot_up && exchange.now_ns - reset_ns_ >= kBootNs;
  if (stage_ == Stage::reset || overdue) {
    stage_ = reset_node(exchange.now_ns, bus) ? Stage::await_boot_up : Stage::reset;
    return;
  }
  // A drive that refuses because its motor is on is reset; only once, to avoid an endless loop.
  if (stage_ == Stage::refused && !reset_after_refusal_) reset_after_refusal_ = reset_node(exchange.now_ns, bus);
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
      if (doubted_ && !silent_) return;  // wait: soon a heartbeat comes, or its timeout
      stage_ = Stage::running;
      reset_after_refusal_ = false;
      // No heartbeat during the set-up: report the reason.
      silent_ ? drop({NotReadyKind::silent, {}, 0}) : set_not_ready({});
      return;
    case Setup::Progress::failed:
      set_not_ready(setup_.not_ready(), setup_.lacks());
      // A lost drive may have been replaced, so it is set up again; one that refused will refuse again.
      stage_ = setup_.not_ready().kind == NotReadyKind::no_answer ? Stage::reset : Stage::refused;
  }
}

// False: the bus had no room for it.
bool Cia402Drive::reset_node(std::int64_t now_ns, Bus& bus) LITHE_RT {
  reset_ns_ = now_ns;
  return bus.send(canopen::nmt_frame(NmtCommand::reset_node, params_.id));
}

void Cia402Drive::set_not_ready(const NotReadyReason& not_ready, std::uint64_t lacks) LITHE_RT {
  // Relaxed: each word is self-contained; between the two a reader may see an old list with a new reason, once. Pairs
  // with why_not_ready().
  lacks_.store(lacks, std::memory_order_relaxed);
  not_ready_.store(not_ready.packed(), std::memory_order_relaxed);
}

std::string Cia402Drive::why_not_ready() const {
  // Relaxed: pairs with set_not_ready().
  const NotReadyReason why = NotReadyReason::unpacked(not_ready_.load(std::memory_order_relaxed));
  return told(why, setup_.lacking(lacks_.load(std::memory_order_relaxed), why.address.index), params_);
}

void Cia402Drive::say(const JointCommand& command, DriveAction action, Bus& bus) LITHE_RT {
  last_control_ = action == DriveAction::off && command.clear_fault ? clearing_word() : control_word(action);
  const bool active = last_control_ == control::kEnable && state_ == State::operation_enabled;
  const RawSetpoint setpoint = active ? limiter_.next(command, last_) : limiter_.rest(position_raw_);
  const std::array<std::uint32_t, 3> values{last_control_, setpoint.target, setpoint.torque};
  // If the bus refuses the command, the drive still answers the SYNC and continues its last command (take_answer).
  told_ = bus.send(command_map_.pack(pdo::command_id(params_.id), values));
}

std::uint16_t Cia402Drive::control_word(DriveAction action) LITHE_RT {
  if (action == DriveAction::damp) return control::kQuickStop;
  if (action != DriveAction::torque) return control::kDisableVoltage;
  resetting_ = (resetting_ || last_action_ == DriveAction::off) && state_ == State::fault && may_enable_;
  if (resetting_) return control::kFaultReset;  // its bit rises once: the word before was that of `off`
  if (state_ == State::fault || state_ == State::fault_reaction_active) may_enable_ = false;
  // This word lets the drive continue a ramp that it started by itself.
  return may_enable_ ? control_to_enable(state_) : control::kQuickStop;
}

// The bit acts on its rising edge: toggle it while the fault is there.
std::uint16_t Cia402Drive::clearing_word() LITHE_RT {
  constexpr std::uint32_t kHeldFor = 8;
  const bool up = state_ == State::fault && clearing_++ / kHeldFor % 2 == 1;
  return up ? control::kFaultReset : control::kDisableVoltage;
}

// In a fault, asks for its code: the emergency frame may have been lost. Without a fault, reads voltage and current.
void Cia402Drive::ask(std::int64_t now_ns, Bus& bus) LITHE_RT {
  if (state_ != State::fault) asked_why_ = false;
  if (state_ == State::fault && error_code_ == 0 && !asked_why_) {
    asked_why_ = true;
    sdo_.read({object::kErrorCode, 0});
  } else {
    report_.ask(now_ns, sdo_);
  }
  Frame frame;
  if (sdo_.next(now_ns, frame)) bus.send(frame);
}

}  // namespace lithe::hal::cia402
