// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/cia402/sim/cia402_dictionary.hpp"

#include <array>
#include <utility>

#include "spine/hal/canopen/canopen.hpp"
#include "spine/hal/canopen/canopen_pdo.hpp"
#include "spine/hal/cia402/cia402.hpp"

namespace lithe::hal::sim {

using canopen::Address;
namespace common = canopen::object;
namespace object = cia402::object;

namespace {

constexpr std::uint32_t kPdos = 4;  // of each direction

}  // namespace

Cia402Dictionary::Cia402Dictionary(const Cia402Identity& identity) {
  add_communication(identity);
  add_pdos(identity.id);
  add_drive(identity);
  add_motion();
}

void Cia402Dictionary::add_communication(const Cia402Identity& identity) {
  add(common::kDeviceType, 0, 4, kReadOnly, identity.device_type);
  add(common::kErrorRegister, 0, 1, kReadOnly, 0);
  add(common::kSyncId, 0, 4, kWritable, canopen::cob::kSync);
  add(common::kSyncPeriodUs, 0, 4, kWritable, 0);
  add(common::kEmergencyId, 0, 4, kReadOnly, canopen::cob::kEmergency + identity.id);
  add(common::kConsumerHeartbeat, 0, 1, kReadOnly, 1);
  add(common::kConsumerHeartbeat, 1, 4, kWritable, 0);
  add(common::kProducerHeartbeatMs, 0, 2, kWritable, 0);
  add(common::kIdentity, 0, 1, kReadOnly, 4);
  constexpr std::array<std::uint32_t, 3> kMade{0, 0x402, 0x00010000};  // no vendor, product, revision
  std::uint8_t subindex = 0;
  for (const std::uint32_t made : kMade) add(common::kIdentity, ++subindex, 4, kReadOnly, made);
  add(common::kIdentity, 4, 4, kReadOnly, identity.id);
  add(common::kErrorBehaviour, 0, 1, kReadOnly, 1);
  add(common::kErrorBehaviour, 1, 1, kWritable, 0);
}

// As the profile has it after power-on: status and control word are exchanged, the rest is off.
void Cia402Dictionary::add_pdos(std::uint32_t id) {
  constexpr std::uint8_t kOnChange = 255;
  const std::uint32_t control = canopen::Mapped{{object::kControlword, 0}, 2}.entry();
  const std::uint32_t status = canopen::Mapped{{object::kStatusword, 0}, 2}.entry();
  for (std::uint16_t i = 0; i < kPdos; ++i) {
    const std::uint32_t off = i == 0 ? 0 : canopen::cob::kOff;
    add(common::kRpdo1 + i, 0, 1, kReadOnly, 2);
    add(common::kRpdo1 + i, 1, 4, kWritable, off | (canopen::cob::kRpdo1 + i * canopen::cob::kNextPdo + id));
    add(common::kRpdo1 + i, 2, 1, kWritable, kOnChange);
    add(common::kTpdo1 + i, 0, 1, kReadOnly, 5);
    add(common::kTpdo1 + i, 1, 4, kWritable, off | (canopen::cob::kTpdo1 + i * canopen::cob::kNextPdo + id));
    add(common::kTpdo1 + i, 2, 1, kWritable, kOnChange);
    add(common::kTpdo1 + i, 3, 2, kWritable, 0);
    add(common::kTpdo1 + i, 5, 2, kWritable, 0);
    const std::uint32_t count = i == 0 ? 1 : 0;
    add(common::kRpdo1Mapping + i, 0, 1, kWritable, count);
    add(common::kTpdo1Mapping + i, 0, 1, kWritable, count);
    for (std::uint8_t n = 1; n <= canopen::PdoMap::kMost; ++n) {
      const bool first = i == 0 && n == 1;
      add(common::kRpdo1Mapping + i, n, 4, kWritable, first ? control : 0);
      add(common::kTpdo1Mapping + i, n, 4, kWritable, first ? status : 0);
    }
  }
}

void Cia402Dictionary::add_drive(const Cia402Identity& identity) {
  add(object::kAbortConnection, 0, 2, kWritable, 1);
  add(object::kErrorCode, 0, 2, kReadOnly, 0);
  add(object::kControlword, 0, 2, kWritable, 0);
  add(object::kStatusword, 0, 2, kReadOnly, 0);
  add(object::kQuickStopOption, 0, 2, kWritable, 2);
  for (std::uint16_t index = 0x605b; index <= 0x605d; ++index) add(index, 0, 2, kWritable, 1);
  add(object::kFaultReactionOption, 0, 2, kWritable, 2);
  add(object::kMode, 0, 1, kWritable, 0);
  add(object::kModeDisplay, 0, 1, kReadOnly, 0);
  add(object::kMaxTorque, 0, 2, kWritable, 1000);
  add(object::kMaxCurrent, 0, 2, kWritable, 1000);
  add(object::kRatedCurrent, 0, 4, kReadOnly, 10'000);
  add(object::kRatedTorque, 0, 4, kReadOnly, identity.rated_torque_mnm);
  add(object::kPositiveTorqueLimit, 0, 2, kWritable, 65535);
  add(object::kNegativeTorqueLimit, 0, 2, kWritable, 65535);
  add(object::kSupportedModes, 0, 4, kReadOnly,
      cia402::supported_bit(cia402::Mode::position) | cia402::supported_bit(cia402::Mode::velocity) |
          cia402::supported_bit(cia402::Mode::torque));
  // Encoder increments per revolution, gear ratio, feed constant.
  const std::array<std::pair<std::uint16_t, std::uint32_t>, 3> factors{
      {{0x608f, identity.counts_per_rev}, {0x6091, 1}, {0x6092, identity.counts_per_rev}}};
  for (const auto& [index, numerator] : factors) {
    add(index, 0, 1, kReadOnly, 2);
    add(index, 1, 4, kReadOnly, numerator);
    add(index, 2, 4, kReadOnly, 1);
  }
  add(object::kFollowingWindow, 0, 4, kWritable, identity.counts_per_rev);
  add(object::kFollowingTimeoutMs, 0, 2, kWritable, 100);
  add(object::kQuickStopDeceleration, 0, 4, kWritable, 100 * identity.counts_per_rev);
}

void Cia402Dictionary::add_motion() {
  for (const std::uint16_t index :
       {object::kPosition, object::kVelocity, object::kFollowingError, std::uint16_t{0x60fd}}) {
    add(index, 0, 4, kReadOnly, 0);
  }
  add(object::kTorque, 0, 2, kReadOnly, 0);
  add(object::kCurrent, 0, 2, kReadOnly, 0);
  add(object::kSupply, 0, 4, kReadOnly, 24'000);
  for (const std::uint16_t index :
       {object::kTargetPosition, object::kTargetVelocity, object::kPositionOffset, object::kVelocityOffset}) {
    add(index, 0, 4, kWritable, 0);
  }
  add(object::kTargetTorque, 0, 2, kWritable, 0);
  add(object::kTorqueOffset, 0, 2, kWritable, 0);
  add(object::kPositionLimit, 0, 1, kReadOnly, 2);
  add(object::kPositionLimit, 1, 4, kWritable, 0);  // equal limits are none
  add(object::kPositionLimit, 2, 4, kWritable, 0);
  // Profile velocity, acceleration, deceleration and their largest values: stored only; their modes are not simulated.
  constexpr std::array<std::uint16_t, 5> kProfile{object::kMaxProfileVelocity, 0x6080, 0x6081, 0x6083, 0x6084};
  for (const std::uint16_t index : kProfile) add(index, 0, 4, kWritable, 0xffff'ffff);
  add(object::kInterpolation, 0, 1, kReadOnly, 2);
  add(object::kInterpolation, 1, 1, kWritable, 1);
  add(object::kInterpolation, 2, 1, kWritable, static_cast<std::uint8_t>(-3));
  add(0x60fe, 0, 1, kReadOnly, 1);
  add(0x60fe, 1, 4, kWritable, 0);
}

std::string_view Cia402Dictionary::text(Address address) LITHE_RT {
  if (address.subindex != 0) return {};
  if (address.index == common::kDeviceName) return "LITHE simulated CiA 402 drive";
  if (address.index == common::kDeviceName + 1) return "hardware 1";
  return address.index == common::kDeviceName + 2 ? "software 1" : "";
}

}  // namespace lithe::hal::sim
