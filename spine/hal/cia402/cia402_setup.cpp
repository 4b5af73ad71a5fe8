// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/cia402/cia402_setup.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "spine/hal/canopen/canopen.hpp"

namespace lithe::hal::cia402 {

using canopen::Mapped;
using canopen::PdoMap;
using canopen::SdoClient;
namespace common = canopen::object;

namespace pdo {

PdoMap command_map(Mode mode) LITHE_RT {
  const Mapped control{{object::kControlword, 0}, 2};
  const Mapped offset{{object::kTorqueOffset, 0}, 2};
  // The velocity offset does not fit beside them: a drive that knows its interpolation period has that velocity.
  if (mode == Mode::position) return {control, {{object::kTargetPosition, 0}, 4}, offset};
  if (mode == Mode::velocity) return {control, {{object::kTargetVelocity, 0}, 4}, offset};
  return {control, {{object::kTargetTorque, 0}, 2}};
}

PdoMap velocity_map() LITHE_RT { return {{{object::kVelocity, 0}, 4}}; }

PdoMap answer_map() LITHE_RT {
  return {{{object::kStatusword, 0}, 2}, {{object::kPosition, 0}, 4}, {{object::kTorque, 0}, 2}};
}

std::uint32_t command_id(std::uint32_t node) LITHE_RT { return canopen::cob::kRpdo1 + node; }

std::uint32_t transmit_id(std::size_t number, std::uint32_t node) LITHE_RT {
  return canopen::cob::kTpdo1 + static_cast<std::uint32_t>(number) * canopen::cob::kNextPdo + node;
}

}  // namespace pdo

namespace {

constexpr std::uint32_t kEverySync = 1;  // transmission type
constexpr double kBeyondRad = 0.1;       // that 607Dh allows beyond a joint that is beyond its limits

}  // namespace

Setup::Setup(const DriverParams& params)
    : node_(params.id),
      host_(params.host_id),
      mode_(params.mode),
      rated_mnm_(1000 * params.rated_torque_nm),
      motor_max_mnm_(1000 * params.torque_max_nm / params.joint.ratio) {
  add(Kind::require_profile, common::kDeviceType);
  // It may still drive its motor: leaving OPERATIONAL does not stop a motor.
  add(Kind::offer, object::kControlword, 0, control::kQuickStop, 2);
  add(Kind::require_mode, object::kSupportedModes);
  add(Kind::require_rating, object::kRatedTorque);
  add_safety(params);
  add_limits(params);
  add_interpolation(params);
  add_pdo(common::kRpdo1, common::kRpdo1Mapping, pdo::command_id(node_), pdo::command_map(mode_));
  const auto add_tpdo = [this](std::uint16_t number, const PdoMap& map) {
    add_pdo(common::kTpdo1 + number, common::kTpdo1Mapping + number,
            canopen::cob::kNoRemote | pdo::transmit_id(number, node_), map);
  };
  add_tpdo(pdo::kVelocity, pdo::velocity_map());
  add_tpdo(pdo::kAnswer, pdo::answer_map());
  // Switches off the other PDOs of the maker's defaults.
  for (std::uint16_t number = 2; number < 4; ++number) {
    const std::uint32_t id = canopen::cob::kNoRemote | pdo::transmit_id(number, node_);
    add(Kind::write_if_there, common::kTpdo1 + number, 1, canopen::cob::kOff | id, 4);
  }
  add(Kind::heartbeat, 0);  // monitoring begins with the first heartbeat: the drive must not move before
  add(Kind::start, 0);
  add(Kind::write, object::kMode, 0, static_cast<std::uint8_t>(mode_), 1);
  add(Kind::await_mode, object::kModeDisplay);
}

void Setup::add(Kind kind, std::uint16_t index, std::uint8_t subindex, std::uint32_t value, std::uint8_t bytes) {
  steps_[count_++] = {kind, {index, subindex}, value, bytes};
}

// None of these may be missing: a drive that lacks one would go on when the host is dead, or stop with more torque than
// the joint may have.
void Setup::add_safety(const DriverParams& params) {
  constexpr std::uint32_t kQuickStop = 3;    // of 6007h
  constexpr std::uint32_t kRampThenOff = 2;  // of 605Ah
  add(Kind::write, common::kConsumerHeartbeat, 1, params.host_id << 16 | canopen::milliseconds(params.watchdog_s), 4);
  add(Kind::write, common::kProducerHeartbeatMs, 0, canopen::milliseconds(params.heartbeat_s), 2);
  add(Kind::write, object::kAbortConnection, 0, kQuickStop, 2);
  add(Kind::write, object::kQuickStopOption, 0, kRampThenOff, 2);
  add(Kind::limit_torque, object::kMaxTorque, 0, 0, 2);
  add(Kind::require_torque_limit, object::kMaxTorque);
}

// What the drive itself keeps to where the host's own limits do not bind: its position and velocity loops are its own.
void Setup::add_limits(const DriverParams& params) {
  if (mode_ != Mode::position && mode_ != Mode::velocity) return;
  const double counts_per_rad = params.joint.rev_per_rad() * params.counts_per_rev;
  const double fastest = std::abs(counts_per_rad) * params.velocity_fault_rad_s;
  add(Kind::offer, object::kMaxProfileVelocity, 0, raw_counts(fastest), 4);
  if (mode_ != Mode::position || params.position_min_rad >= params.position_max_rad) return;
  const double one = params.joint.motor_rev(params.position_min_rad) * params.counts_per_rev;
  const double other = params.joint.motor_rev(params.position_max_rad) * params.counts_per_rev;
  limits_at_ = count_;
  least_raw_ = static_cast<std::int32_t>(raw_counts(std::min(one, other)));
  most_raw_ = static_cast<std::int32_t>(raw_counts(std::max(one, other)));
  margin_raw_ = std::llround(std::abs(counts_per_rad) * kBeyondRad);
  add(Kind::write_if_there, object::kPositionLimit, 1, static_cast<std::uint32_t>(least_raw_), 4);
  add(Kind::write_if_there, object::kPositionLimit, 2, static_cast<std::uint32_t>(most_raw_), 4);
}

bool Setup::must_move_limits(std::int32_t position_raw) LITHE_RT {
  if (limits_at_ == 0) return false;
  std::uint32_t &least = steps_[limits_at_].value, &most = steps_[limits_at_ + 1].value;
  const auto low = static_cast<std::int32_t>(least), high = static_cast<std::int32_t>(most);
  const bool covered = position_raw >= low && position_raw <= high;
  const bool wide = low != least_raw_ || high != most_raw_;
  const bool well_inside = position_raw >= least_raw_ + margin_raw_ && position_raw <= most_raw_ - margin_raw_;
  if (covered && !(wide && well_inside)) return false;
  constexpr std::int64_t kLeast = std::numeric_limits<std::int32_t>::min();
  constexpr std::int64_t kMost = std::numeric_limits<std::int32_t>::max();
  const std::int64_t at = position_raw;
  least = static_cast<std::uint32_t>(at < least_raw_ ? std::max(at - margin_raw_, kLeast) : least_raw_);
  most = static_cast<std::uint32_t>(at > most_raw_ ? std::min(at + margin_raw_, kMost) : most_raw_);
  return true;
}

// The period as one byte times a power of ten. Where targets are positions the drive must know it.
void Setup::add_interpolation(const DriverParams& params) {
  int power = -2;
  double count = 0;
  for (; power > -6; --power) {
    count = params.period_s / std::pow(10.0, power);
    if (count >= 1 && std::abs(count - std::round(count)) < 1e-3) break;
    if (count * 10 > 255) break;  // not a round number: as exactly as a byte can say it
  }
  const Kind kind = mode_ == Mode::position ? Kind::write : Kind::offer;
  const double rounded = std::clamp(std::round(count), 1.0, 255.0);
  add(kind, object::kInterpolation, 1, static_cast<std::uint32_t>(rounded), 1);
  add(kind, object::kInterpolation, 2, static_cast<std::uint8_t>(power), 1);
}

void Setup::add_pdo(std::uint16_t communication, std::uint16_t mapping, std::uint32_t id, const PdoMap& map) {
  add(Kind::write, communication, 1, canopen::cob::kOff | id, 4);
  add(Kind::write, mapping, 0, 0, 1);
  std::uint8_t number = 0;
  for (const Mapped& object : map.objects()) add(Kind::write, mapping, ++number, object.entry(), 4);
  add(Kind::write, mapping, 0, number, 1);
  add(Kind::write, communication, 2, kEverySync, 1);
  add(Kind::write, communication, 1, id, 4);
}

void Setup::begin(SdoClient& client, bool look) LITHE_RT {
  at_ = 0;
  looks_ = 0;
  only_looks_ = look;
  lacks_ = 0;
  not_ready_ = {};
  client.forget();
}

bool Setup::next(std::int64_t now_ns, SdoClient& client, Frame& frame) LITHE_RT {
  if (at_ >= count_) return false;
  const Step& step = steps_[at_];
  if (step.kind == Kind::heartbeat || step.kind == Kind::start) {
    ++at_;
    if (only_looks_) return false;
    frame = step.kind == Kind::heartbeat ? canopen::heartbeat_frame(host_, canopen::NmtState::operational)
                                         : canopen::nmt_frame(canopen::NmtCommand::start, node_);
    return true;
  }
  if (client.outcome() == SdoClient::Outcome::idle) {
    if (step.bytes == 0 || only_looks_)
      client.read(only_looks_ ? canopen::mapped_or_self(step.address, step.value) : step.address);
    else
      client.write(step.address, step.kind == Kind::limit_torque ? torque_limit_ : step.value, step.bytes);
  }
  return client.next(now_ns, frame);
}

Setup::Progress Setup::advance(SdoClient& client) LITHE_RT {
  if (at_ >= count_) return not_ready_.kind == NotReadyKind::none ? Progress::done : Progress::failed;
  const Step& step = steps_[at_];
  bool passed = false;
  switch (client.outcome()) {
    case SdoClient::Outcome::idle:
    case SdoClient::Outcome::busy:
      return Progress::busy;
    case SdoClient::Outcome::done:
      passed = step.bytes > 0 || judge(step, client.value());
      break;
    case SdoClient::Outcome::failed:
      passed = bear(step, client.abort());
      break;
  }
  client.forget();
  only_looks_ = only_looks_ || not_ready_.kind != NotReadyKind::none;
  const bool gone = client.abort() == canopen::abort_code::kTimedOut;
  if (passed || (only_looks_ && !gone)) ++at_;
  if (not_ready_.kind == NotReadyKind::none) return at_ >= count_ ? Progress::done : Progress::busy;
  return gone || at_ >= count_ ? Progress::failed : Progress::busy;
}

// True: the drive may do so.
bool Setup::bear(const Step& step, std::uint32_t why) LITHE_RT {
  if (why == canopen::abort_code::kTimedOut) return refuse(NotReadyKind::no_answer, step, why);
  const bool lacks = why == canopen::abort_code::kNoObject || why == canopen::abort_code::kNoSubindex;
  const bool may_refuse = step.kind == Kind::offer || step.kind == Kind::limit_torque;
  if (may_refuse || (step.kind == Kind::write_if_there && lacks)) return true;
  if (only_looks_ && !lacks) return true;  // it is there, though it cannot be read
  if (lacks && only_looks_) lacks_ |= std::uint64_t{1} << at_;
  return refuse(NotReadyKind::refused, step, why);
}

// The first reason stays.
bool Setup::refuse(NotReadyKind kind, const Step& step, std::uint32_t value) LITHE_RT {
  const canopen::Address at = only_looks_ ? canopen::mapped_or_self(step.address, step.value) : step.address;
  if (not_ready_.kind == NotReadyKind::none) not_ready_ = {kind, at, value};
  return false;
}

std::string Setup::lacking(std::uint64_t lacks, std::uint16_t but_for) const {
  canopen::ObjectList list(but_for);
  for (std::size_t i = 0; i < count_; ++i)
    if ((lacks >> i & 1U) != 0) list.add(canopen::mapped_or_self(steps_[i].address, steps_[i].value));
  return list.text();
}

// What was read. False: not yet, or with a reason that it is not ready: never.
bool Setup::judge(const Step& step, std::uint32_t value) LITHE_RT {
  constexpr double kRatingTolerance = 0.05;
  switch (step.kind) {
    case Kind::require_profile:
      return (value & 0xffff) == kDeviceProfile || refuse(NotReadyKind::not_a_drive, step, value);
    case Kind::require_mode:
      return (value & supported_bit(mode_)) != 0 || refuse(NotReadyKind::mode_unsupported, step, value);
    case Kind::require_rating:
      if (!(std::abs(value - rated_mnm_) <= kRatingTolerance * rated_mnm_))
        return refuse(NotReadyKind::rated_torque, step, value);
      // Rounded down, but not from a number that is whole but for the last bits of a double.
      torque_limit_ = static_cast<std::uint32_t>(std::clamp(1000 * motor_max_mnm_ / value + 1e-6, 0.0, 65535.0));
      return true;
    case Kind::require_torque_limit:
      return only_looks_ || (value & 0xffff) <= torque_limit_ ||
             refuse(NotReadyKind::torque_limit, step, value & 0xffff);
    case Kind::await_mode:
      if (only_looks_ || (value & 0xff) == static_cast<std::uint8_t>(mode_)) return true;
      if (++looks_ >= kMostLooks) refuse(NotReadyKind::mode_not_taken, step, value);
      return false;
    default:
      return true;
  }
}

namespace {

const char* mode_word(Mode mode) {
  if (mode == Mode::position) return "position";
  return mode == Mode::velocity ? "velocity" : "torque";
}

// By NotReadyKind. 0: the object, 1: the abort code, 2: the value, 3: its low 16 bits, 4: its low 8 bits as a number
// with a sign, 5: as a state, 6: in thousandths, 7: the robot file's rated torque [mNm], 8: its mode.
constexpr const char* kNotReady[] = {
    "",
    "no boot-up message after a reset; check its power, cable, node id and bit rate",
    "no answer when asked for object {0}; check the cable",
    "object {0} is refused with abort {1}; the drive lacks what LITHE needs of it",
    "device type {0} = 0x{2:08X} is profile {3}, not 402; give the robot file the id of a drive",
    "supported modes {0} = 0x{2:08X} lack mode = \"{8}\" of the robot file; choose another mode",
    "rated torque {0} = {2} mNm is not the robot file's rated_torque_nm, {7} mNm; correct the one that is wrong",
    ("max torque {0} = {2} thousandths of the rated torque is more than torque_max_nm, and the drive takes no less "
     "from "
     "here: what it does by itself (quick stop, fault reaction) would have more; set it lower in the drive, or raise "
     "torque_max_nm"),
    "mode display {0} stays at {4}; the drive does not take mode = \"{8}\" of the robot file",
    "left the state operational by itself (now 0x{2:02X}) and is being set up again",
    ("no heartbeat (1017h); check its power and cable; while it is switched off (reset) it is reset and set up anew "
     "every 5 s"),
    "does not answer; stopped until it is switched off and on (reset, arm)",
    "stopped by itself (now: {5}); check torque-off inputs and limit switches, then switch it off and on (reset, arm)",
    ("cannot be switched on (now: {5}); check its power stage, torque-off inputs and brake, then switch it off and on "
     "(reset, arm)"),
    "velocity 606Ch is {6:.3f} of how fast position 6064h changes; set the drive's velocity unit to counts per second",
};
constexpr const char* kNoMaxTorque =
    "max torque {0} is refused with abort {1}; without it nothing keeps what the drive does by itself (quick stop, "
    "fault reaction) below torque_max_nm";

}  // namespace

std::string describe(const NotReadyReason& not_ready, const DriverParams& params) {
  const auto& [index, subindex] = not_ready.address;
  const std::uint32_t value = not_ready.value;
  const bool no_limit = not_ready.kind == NotReadyKind::refused && index == object::kMaxTorque;
  return fmt::format(fmt::runtime(no_limit ? kNoMaxTorque : kNotReady[static_cast<std::size_t>(not_ready.kind)]),
                     fmt::format("{:04X}h:{:02X}", index, subindex),
                     fmt::format("0x{:08X} ({})", value, canopen::abort_name(value)), value, value & 0xffff,
                     static_cast<int>(static_cast<std::int8_t>(value)), state_name(static_cast<State>(value)),
                     static_cast<std::int32_t>(value) * 1e-3, 1000 * params.rated_torque_nm, mode_word(params.mode));
}

std::string told(const NotReadyReason& not_ready, const std::string& lacking, const DriverParams& params) {
  return describe(not_ready, params) + (lacking.empty() ? "" : "; it lacks " + lacking + ", too");
}

}  // namespace lithe::hal::cia402
