// SPDX-License-Identifier: Apache-2.0
// What keeps a drive from being commanded, in words.
#include <cstdio>

#include "spine/hal/cia402/cia402_setup.hpp"

namespace lithe::hal::cia402 {
namespace {

std::string hex(std::uint32_t value, int digits) {
  std::array<char, 16> text{};
  std::snprintf(text.data(), text.size(), "%0*X", digits, static_cast<unsigned>(value));
  return text.data();
}

std::string state_of(const NotReadyReason& not_ready) {
  return std::string(state_name(static_cast<State>(not_ready.value)));
}

std::string per_mille(std::uint32_t value) {
  std::array<char, 16> text{};
  std::snprintf(text.data(), text.size(), "%.3f", static_cast<std::int32_t>(value) * 1e-3);
  return text.data();
}

std::string object_name(const canopen::Address& address) {
  return hex(address.index, 4) + "h:" + hex(address.subindex, 2);
}

}  // namespace

std::uint64_t NotReadyReason::packed() const LITHE_RT {
  return std::uint64_t{static_cast<std::uint8_t>(kind)} << 56 | std::uint64_t{address.subindex} << 48 |
         std::uint64_t{address.index} << 32 | value;
}

NotReadyReason NotReadyReason::unpacked(std::uint64_t word) LITHE_RT {
  return {static_cast<TroubleKind>(word >> 56),
          {static_cast<std::uint16_t>(word >> 32), static_cast<std::uint8_t>(word >> 48)},
          static_cast<std::uint32_t>(word)};
}

std::string describe(const NotReadyReason& not_ready) {
  const std::string where = object_name(not_ready.address);
  const std::string why =
      "0x" + hex(not_ready.value, 8) + " (" + std::string(canopen::abort_name(not_ready.value)) + ")";
  switch (not_ready.kind) {
    case TroubleKind::none:
      return "";
    case TroubleKind::not_booted:
      return "no boot-up message after a reset; check its power, cable, node id and bit rate";
    case TroubleKind::no_answer:
      return "no answer when asked for object " + where + "; check the cable";
    case TroubleKind::refused:
      if (not_ready.address.index == object::kMaxTorque) {
        return "max torque " + where + " is refused with abort " + why +
               "; without it nothing keeps what the drive does by itself (quick stop, fault reaction) below "
               "torque_max_nm";
      }
      return "object " + where + " is refused with abort " + why + "; the drive lacks what LITHE needs of it";
    case TroubleKind::not_a_drive:
      return "device type " + where + " = 0x" + hex(not_ready.value, 8) + " is profile " +
             std::to_string(not_ready.value & 0xffff) + ", not 402; give the robot file the id of a drive";
    case TroubleKind::mode_unsupported:
      return "supported modes " + where + " = 0x" + hex(not_ready.value, 8) +
             " lack the mode of the robot file; choose another mode";
    case TroubleKind::rated_torque:
      return "rated torque " + where + " = " + std::to_string(not_ready.value) +
             " mNm is not the robot file's rated_torque_nm; correct the one that is wrong";
    case TroubleKind::torque_limit:
      return "max torque " + where + " = " + std::to_string(not_ready.value) +
             " thousandths of the rated torque is more than torque_max_nm, and the drive takes no less from here: what "
             "it "
             "does by itself (quick stop, fault reaction) would have more; set it lower in the drive, or raise "
             "torque_max_nm";
    case TroubleKind::mode_not_taken:
      return "mode display " + where + " stays at " + std::to_string(static_cast<std::int8_t>(not_ready.value)) +
             "; the drive does not take the mode of the robot file";
    case TroubleKind::left_operational:
      return "left the state operational by itself (now 0x" + hex(not_ready.value, 2) + ") and is being set up again";
    case TroubleKind::silent:
      return "no heartbeat (1017h); check its power and cable; while it is switched off (reset) it is reset and set up "
             "anew every 5 s";
    case TroubleKind::unheard:
      return "does not answer; stopped until it is switched off and on (reset, arm)";
    case TroubleKind::left_enabled:
      return "stopped by itself (now: " + state_of(not_ready) +
             "); check torque-off inputs and limit switches, then switch it off and on (reset, arm)";
    case TroubleKind::not_enabled:
      return "cannot be switched on (now: " + state_of(not_ready) +
             "); check its power stage, torque-off inputs and brake, then switch it off and on (reset, arm)";
    case TroubleKind::velocity_unit:
      return "velocity 606Ch is " + per_mille(not_ready.value) +
             " of how fast position 6064h changes; set the drive's velocity unit to counts per second";
  }
  return "";
}

}  // namespace lithe::hal::cia402
