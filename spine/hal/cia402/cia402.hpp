// SPDX-License-Identifier: Apache-2.0
// The drive profile CiA 402: states, control words, objects. Pure.
//
//   not ready (0) -> switch on disabled (1) <-> ready to switch on (2) <-> switched on (3) <-> operation enabled (4)
//   operation enabled -> quick stop active (5) -> switch on disabled;  any -> fault reaction (6) -> fault (7) -> (1)
#pragma once

#include <cstdint>
#include <string_view>

#include "spine/core/rt.hpp"
#include "spine/hal/cia402/keys/cia402_keys.hpp"

namespace lithe::hal::cia402 {

// Objects of the drive profile, by index.
namespace object {
inline constexpr std::uint16_t kAbortConnection = 0x6007;  // the drive's reaction to a heartbeat timeout
inline constexpr std::uint16_t kErrorCode = 0x603f;
inline constexpr std::uint16_t kControlword = 0x6040;
inline constexpr std::uint16_t kStatusword = 0x6041;
inline constexpr std::uint16_t kQuickStopOption = 0x605a;
inline constexpr std::uint16_t kFaultReactionOption = 0x605e;
inline constexpr std::uint16_t kMode = 0x6060;
inline constexpr std::uint16_t kModeDisplay = 0x6061;
inline constexpr std::uint16_t kPosition = 0x6064;
inline constexpr std::uint16_t kFollowingWindow = 0x6065;
inline constexpr std::uint16_t kFollowingTimeoutMs = 0x6066;
inline constexpr std::uint16_t kVelocity = 0x606c;
inline constexpr std::uint16_t kTargetTorque = 0x6071;  // thousandths of the rated torque, as all torques
inline constexpr std::uint16_t kMaxTorque = 0x6072;
inline constexpr std::uint16_t kMaxCurrent = 0x6073;
inline constexpr std::uint16_t kRatedCurrent = 0x6075;  // mA
inline constexpr std::uint16_t kRatedTorque = 0x6076;   // mNm
inline constexpr std::uint16_t kTorque = 0x6077;
inline constexpr std::uint16_t kCurrent = 0x6078;
inline constexpr std::uint16_t kSupply = 0x6079;  // mV
inline constexpr std::uint16_t kTargetPosition = 0x607a;
inline constexpr std::uint16_t kPositionLimit = 0x607d;  // :1 smallest, :2 largest
inline constexpr std::uint16_t kMaxProfileVelocity = 0x607f;
inline constexpr std::uint16_t kQuickStopDeceleration = 0x6085;
inline constexpr std::uint16_t kPositionOffset = 0x60b0;
inline constexpr std::uint16_t kVelocityOffset = 0x60b1;
inline constexpr std::uint16_t kTorqueOffset = 0x60b2;
inline constexpr std::uint16_t kInterpolation = 0x60c2;  // :1 count, :2 power of ten of a second
inline constexpr std::uint16_t kPositiveTorqueLimit = 0x60e0;
inline constexpr std::uint16_t kNegativeTorqueLimit = 0x60e1;
inline constexpr std::uint16_t kFollowingError = 0x60f4;
inline constexpr std::uint16_t kTargetVelocity = 0x60ff;
inline constexpr std::uint16_t kSupportedModes = 0x6502;
}  // namespace object

inline constexpr std::uint32_t kDeviceProfile = 402;  // low half of object 1000h

constexpr bool is_cyclic(Mode mode) LITHE_RT { return mode >= Mode::position && mode <= Mode::torque; }

// Bit of a mode in object 6502h.
constexpr std::uint32_t supported_bit(Mode mode) LITHE_RT { return 1U << (static_cast<unsigned>(mode) - 1); }

// As numbered above: wire::joint_status carries them.
enum class State : std::uint8_t {
  not_ready = 0,
  switch_on_disabled = 1,
  ready_to_switch_on = 2,
  switched_on = 3,
  operation_enabled = 4,
  quick_stop_active = 5,
  fault_reaction_active = 6,
  fault = 7,
};

std::string_view state_name(State state) LITHE_RT;

// False: the word matches no state; `state` is unchanged.
bool decode_state(std::uint16_t statusword, State& state) LITHE_RT;
// The status bits of a state. For the drive's side.
std::uint16_t encode_state(State state) LITHE_RT;

namespace status_bit {
inline constexpr std::uint16_t kVoltage = 1U << 4;
inline constexpr std::uint16_t kRemote = 1U << 9;
inline constexpr std::uint16_t kLimited = 1U << 11;
inline constexpr std::uint16_t kFollows = 1U << 12;
inline constexpr std::uint16_t kFollowingError = 1U << 13;
}  // namespace status_bit

namespace control {
inline constexpr std::uint16_t kDisableVoltage = 0x00;
inline constexpr std::uint16_t kQuickStop = 0x02;
inline constexpr std::uint16_t kShutdown = 0x06;
inline constexpr std::uint16_t kSwitchOn = 0x07;
inline constexpr std::uint16_t kEnable = 0x0f;
inline constexpr std::uint16_t kFaultReset = 0x80;  // acts on its rising edge
}  // namespace control

// The next control word on the shortest way to `operation enabled`. None out of a fault: that needs a fault reset.
std::uint16_t control_to_enable(State state) LITHE_RT;

// The nearest integer that fits an object of 32 bits, as two's complement; 0 for NaN.
std::uint32_t raw_counts(double value) LITHE_RT;

}  // namespace lithe::hal::cia402
