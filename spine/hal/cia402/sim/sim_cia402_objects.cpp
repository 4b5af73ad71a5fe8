// SPDX-License-Identifier: Apache-2.0
// What the SDO server of a simulated drive reads, and the effects of writes.
#include <algorithm>
#include <cmath>

#include "spine/core/time.hpp"
#include "spine/hal/cia402/sim/sim_cia402.hpp"

namespace lithe::hal::sim {

using canopen::Address;
namespace abort_code = canopen::abort_code;
namespace cob = canopen::cob;
namespace common = canopen::object;
namespace object = cia402::object;

namespace {

constexpr std::uint16_t kPdoGroup = 0xfffc;  // four of each kind, one behind the other

bool is_mapping(std::uint16_t index) LITHE_RT {
  return (index & kPdoGroup) == common::kRpdo1Mapping || (index & kPdoGroup) == common::kTpdo1Mapping;
}
bool is_communication(std::uint16_t index) LITHE_RT {
  return (index & kPdoGroup) == common::kRpdo1 || (index & kPdoGroup) == common::kTpdo1;
}
constexpr std::uint16_t kToCommunication = common::kRpdo1Mapping - common::kRpdo1;
static_assert(kToCommunication == common::kTpdo1Mapping - common::kTpdo1);

bool is_mode(std::uint32_t value) LITHE_RT {
  const auto mode = static_cast<cia402::Mode>(static_cast<std::int8_t>(value));
  return mode == cia402::Mode::none || (mode >= cia402::Mode::position && mode <= cia402::Mode::torque);
}

}  // namespace

std::uint32_t SimCia402::read_object(Cia402Dictionary::Slot slot) LITHE_RT {
  constexpr std::uint32_t kInputsAndOutputs = 0x0003'0191;
  refresh_actuals();
  const bool foreign = other_map_ && dictionary_.address(slot).index == common::kDeviceType;
  return foreign ? kInputsAndOutputs : dictionary_.raw(slot);
}

std::uint32_t SimCia402::write_object(Cia402Dictionary::Slot slot, std::uint32_t value) LITHE_RT {
  const Address address = dictionary_.address(slot);
  if (params_.refuses_while_on && servo_.state() == cia402::State::operation_enabled && is_settled(address.index))
    return abort_code::kState;
  if (is_mapping(address.index) || is_communication(address.index)) {
    const std::uint32_t why = write_pdo(address, value);
    if (why != abort_code::kNone) return why;
  }
  if (address.index == object::kMode && !is_mode(value)) return abort_code::kValue;
  dictionary_.set_raw(slot, value);
  written(address);
  return abort_code::kNone;
}

// Objects that cannot be written while the motor is on.
bool SimCia402::is_settled(std::uint16_t index) const LITHE_RT {
  return is_mapping(index) || is_communication(index) || index == object::kAbortConnection ||
         index == object::kQuickStopOption || index == object::kMaxTorque || index == object::kPositionLimit;
}

// Remapping in the standard's order: off, count 0, objects, count, on.
std::uint32_t SimCia402::write_pdo(Address address, std::uint32_t value) LITHE_RT {
  constexpr std::uint32_t kExtended = 1U << 29;
  if (is_communication(address.index)) {
    if (address.subindex != 1) return abort_code::kNone;
    const bool transmits = (address.index & kPdoGroup) == common::kTpdo1;
    if (params_.knows_no_remote && transmits && (value & cob::kNoRemote) == 0) return abort_code::kValue;
    const bool bad_id = (value & kExtended) != 0 || (value & 0x1fff'ffff) > 0x7ff || (value & 0x7ff) < cob::kTpdo1;
    return bad_id ? abort_code::kValue : abort_code::kNone;
  }
  const auto communication = static_cast<std::uint16_t>(address.index - kToCommunication);
  if ((dictionary_.value(communication, 1) & cob::kOff) == 0) return abort_code::kState;
  if (address.subindex == 0) return check_mapping(address, value);
  return dictionary_.value(address.index, 0) == 0 ? abort_code::kNone : abort_code::kUnsupportedAccess;
}

std::uint32_t SimCia402::check_mapping(Address count, std::uint32_t value) const LITHE_RT {
  if (value > canopen::PdoMap::kMost) return abort_code::kValue;
  canopen::PdoMap map;
  for (std::uint32_t i = 1; i <= value; ++i) {
    const std::uint32_t entry = dictionary_.value(count.index, static_cast<std::uint8_t>(i));
    const Address address{static_cast<std::uint16_t>(entry >> 16), static_cast<std::uint8_t>(entry >> 8)};
    const auto slot = dictionary_.find(address);
    if (!slot || !dictionary_.mappable(*slot)) return abort_code::kNotMappable;
    const std::uint8_t bytes = dictionary_.bytes(*slot);
    if ((entry & 0xff) != bytes * 8U) return abort_code::kNotMappable;
    if (!map.add({address, bytes})) return abort_code::kPdoTooLong;
  }
  return abort_code::kNone;
}

void SimCia402::written(Address address) LITHE_RT {
  if (is_mapping(address.index) || is_communication(address.index)) return rebuild_pdos();
  if (address.index == common::kProducerHeartbeatMs) {
    producer_.set_period(dictionary_.value(address.index) * kNsPerMs);
  } else if (address.index == common::kConsumerHeartbeat) {
    const std::uint32_t said = dictionary_.value(address.index, 1);
    consumer_.set_timeout((said >> 16 & 0x7f) == 0 ? 0 : (said & 0xffff) * kNsPerMs);
  } else if (address.index == object::kControlword) {
    servo_.control(static_cast<std::uint16_t>(dictionary_.value(address.index)));
  } else {
    refresh_inputs();
  }
}

void SimCia402::rebuild_pdos() LITHE_RT {
  for (std::uint16_t i = 0; i < kPdos; ++i) {
    receive_[i].rebuild(dictionary_, common::kRpdo1 + i, common::kRpdo1Mapping + i);
    transmit_[i].rebuild(dictionary_, common::kTpdo1 + i, common::kTpdo1Mapping + i);
  }
}

void SimCia402::refresh_inputs() LITHE_RT {
  const Cia402Dictionary& d = dictionary_;
  // Through an RPDO the mode can have any value; an unknown mode counts as none.
  const std::uint32_t mode = d.value(object::kMode);
  const std::uint32_t limit = d.value(object::kMaxTorque);
  // An invalid exponent must not make an endless period.
  const int power = std::clamp(d.signed_value(object::kInterpolation, 2), -9, 0);
  const double period_s = d.value(object::kInterpolation, 1) * std::pow(10.0, power);
  servo_.set_inputs({
      .mode = is_mode(mode) ? static_cast<cia402::Mode>(mode) : cia402::Mode::none,
      .target_position = d.signed_value(object::kTargetPosition),
      .target_velocity = d.signed_value(object::kTargetVelocity),
      .target_torque = d.signed_value(object::kTargetTorque),
      .position_offset = d.signed_value(object::kPositionOffset),
      .velocity_offset = d.signed_value(object::kVelocityOffset),
      .torque_offset = d.signed_value(object::kTorqueOffset),
      .position_min = d.signed_value(object::kPositionLimit, 1),
      .position_max = d.signed_value(object::kPositionLimit, 2),
      .positive_torque = std::min(limit, d.value(object::kPositiveTorqueLimit)),
      .negative_torque = std::min(limit, d.value(object::kNegativeTorqueLimit)),
      .following_window = d.value(object::kFollowingWindow),
      .following_timeout_ms = d.value(object::kFollowingTimeoutMs),
      .deceleration = d.value(object::kQuickStopDeceleration),
      .quick_stop_option = d.signed_value(object::kQuickStopOption),
      .fault_reaction_option = d.signed_value(object::kFaultReactionOption),
      .period_ns = static_cast<std::int64_t>(1e9 * period_s),
  });
}

void SimCia402::refresh_actuals() LITHE_RT {
  const auto set = [this](std::uint16_t index, std::int32_t value)
                       LITHE_RT { dictionary_.set(index, static_cast<std::uint32_t>(value)); };
  set(object::kStatusword, servo_.statusword());
  set(object::kModeDisplay, static_cast<std::int32_t>(dictionary_.value(object::kMode)));
  set(object::kPosition, servo_.position());
  set(object::kVelocity, servo_.velocity());
  set(object::kTorque, servo_.torque());
  set(object::kCurrent, servo_.torque());  // current in thousandths of rated, like torque
  set(object::kFollowingError, servo_.following_error());
}

}  // namespace lithe::hal::sim
