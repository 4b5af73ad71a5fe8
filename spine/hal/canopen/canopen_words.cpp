// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/canopen/canopen_words.hpp"

#include "spine/hal/canopen/canopen.hpp"

namespace lithe::hal::canopen {

std::string_view emergency_name(std::uint16_t code) {
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

std::string hex(std::uint32_t value, std::size_t digits) {
  constexpr std::string_view kDigits = "0123456789abcdef";
  std::string text;
  for (; value != 0 || text.size() < digits; value >>= 4) text.insert(text.begin(), kDigits[value & 0xf]);
  return text;
}

std::string_view word(NmtState state) {
  switch (state) {
    case NmtState::boot_up:
      return "boot-up";
    case NmtState::stopped:
      return "stopped";
    case NmtState::operational:
      return "operational";
    case NmtState::pre_operational:
      return "pre-operational";
  }
  return "no known state";
}

std::string_view word(NmtCommand command) {
  switch (command) {
    case NmtCommand::start:
      return "start";
    case NmtCommand::stop:
      return "stop";
    case NmtCommand::enter_pre_operational:
      return "enter pre-operational";
    case NmtCommand::reset_node:
      return "reset node";
    case NmtCommand::reset_communication:
      return "reset communication";
  }
  return "no known command";
}

}  // namespace lithe::hal::canopen
