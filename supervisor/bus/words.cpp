// SPDX-License-Identifier: Apache-2.0
#include "supervisor/bus/words.hpp"

#include "spine/hal/registry.hpp"

namespace lithe::bus {

using hal::canopen::NmtCommand;
using hal::canopen::NmtState;

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

std::string drive_words(robot::DeviceKind kind, std::uint32_t joint_status) {
  const auto words = hal::type_of(kind).state_words;
  return words == nullptr ? "" : words(joint_status >> 16 & 0xff, joint_status >> 8 & 0xff);
}

}  // namespace lithe::bus
