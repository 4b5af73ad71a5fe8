// SPDX-License-Identifier: Apache-2.0
#include "supervisor/bus/drive_words.hpp"

#include <fmt/format.h>

#include "spine/hal/canopen/canopen.hpp"
#include "spine/hal/cia402/cia402.hpp"
#include "spine/hal/moteus/moteus_faults.hpp"

namespace lithe::bus {
namespace {

constexpr std::uint32_t kUnnamedClass = 0xff;  // of a drive that failed and sent no emergency

std::string moteus_words(std::uint32_t mode, std::uint32_t code) {
  namespace moteus = hal::moteus;
  const std::string words = moteus::mode_name(static_cast<moteus::Mode>(mode));
  if (code == 0) return words;
  return fmt::format("{}{}: {} ({})", words, moteus::is_limit(code) ? ", at its limit" : "", moteus::fault_name(code),
                     code);
}

std::string cia402_words(std::uint32_t state, std::uint32_t error_class) {
  const std::string words(hal::cia402::state_name(static_cast<hal::cia402::State>(state)));
  if (error_class == 0) return words;
  if (error_class == kUnnamedClass) return words + ": it does not say why";
  const auto code = static_cast<std::uint16_t>(error_class << 8);
  return fmt::format("{}: {} ({:02x}xxh)", words, emergency_name(code), error_class);
}

}  // namespace

std::string drive_words(robot::DeviceKind kind, std::uint32_t joint_status) {
  const std::uint32_t code = joint_status >> 8 & 0xff, mode = joint_status >> 16 & 0xff;
  switch (kind) {
    case robot::DeviceKind::moteus:
      return moteus_words(mode, code);
    case robot::DeviceKind::cia402:
      return cia402_words(mode, code);
    case robot::DeviceKind::gateway:
    case robot::DeviceKind::imu:
      break;
  }
  return "";
}

std::string_view emergency_name(std::uint16_t code) {
  namespace emergency = hal::canopen::emergency;
  switch (code) {
    case emergency::kOverCurrent:
      return "over-current";
    case emergency::kOverVoltage:
      return "over-voltage";
    case emergency::kUnderVoltage:
      return "under-voltage";
    case emergency::kTooHot:
      return "too hot";
    case emergency::kSensor:
      return "sensor";
    case emergency::kHeartbeatLost:
      return "heartbeat lost";
    case emergency::kPdoTooShort:
      return "process data too short";
    case emergency::kFollowingError:
      return "following error";
    default:
      break;
  }
  switch (code >> 12) {
    case 1:
      return "generic";
    case 2:
      return "current";
    case 3:
      return "voltage";
    case 4:
      return "temperature";
    case 5:
      return "hardware";
    case 6:
      return "software";
    case 7:
      return "additional modules";
    case 8:
      return "monitoring";
    default:
      return "of the maker's own";
  }
}

}  // namespace lithe::bus
