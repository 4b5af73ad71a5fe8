// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/canopen/canopen_words.hpp"

#include <iterator>

#include "spine/hal/canopen/canopen.hpp"

namespace lithe::hal::canopen {

namespace {

constexpr Names kEmergencies[] = {
    {emergency::kOverCurrent, "over-current"},
    {emergency::kOverVoltage, "over-voltage"},
    {emergency::kUnderVoltage, "under-voltage"},
    {emergency::kTooHot, "too hot"},
    {emergency::kSensor, "sensor"},
    {emergency::kHeartbeatLost, "heartbeat lost"},
    {emergency::kPdoTooShort, "process data too short"},
    {emergency::kFollowingError, "following error"},
};
// By the uppermost digit, from 1.
constexpr std::string_view kClasses[] = {
    "generic", "current", "voltage", "temperature", "hardware", "software", "additional modules", "monitoring"};

}  // namespace

std::string_view emergency_name(std::uint16_t code) {
  const std::size_t first = code >> 12;
  return name_in(kEmergencies, code, first - 1 < std::size(kClasses) ? kClasses[first - 1] : "of the maker's own");
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
