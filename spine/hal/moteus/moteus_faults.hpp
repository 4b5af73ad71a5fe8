// SPDX-License-Identifier: Apache-2.0
// Codes of a moteus's fault register, and their names.
#pragma once

#include <cstdint>

#include "spine/core/rt.hpp"
#include "spine/hal/moteus/moteus_codec.hpp"

namespace lithe::hal::moteus {

namespace fault {
inline constexpr std::uint32_t kCalibration = 32;
inline constexpr std::uint32_t kDriver = 33;
inline constexpr std::uint32_t kOverVoltage = 34;
inline constexpr std::uint32_t kEncoder = 35;
inline constexpr std::uint32_t kNotConfigured = 36;
inline constexpr std::uint32_t kPwmOverrun = 37;
inline constexpr std::uint32_t kOverTemperature = 38;
inline constexpr std::uint32_t kOutsideLimit = 39;
inline constexpr std::uint32_t kUnderVoltage = 40;
inline constexpr std::uint32_t kConfigChanged = 41;
inline constexpr std::uint32_t kThetaInvalid = 42;
inline constexpr std::uint32_t kPositionInvalid = 43;
inline constexpr std::uint32_t kDriverEnable = 44;
inline constexpr std::uint32_t kStopPosition = 45;
inline constexpr std::uint32_t kTiming = 46;
inline constexpr std::uint32_t kBackEmf = 47;
inline constexpr std::uint32_t kInvalidLimits = 48;
inline constexpr std::uint32_t kPositionError = 49;
inline constexpr std::uint32_t kVelocityError = 50;
inline constexpr std::uint32_t kLimitVelocity = 96;
inline constexpr std::uint32_t kLimitPower = 97;
inline constexpr std::uint32_t kLimitVoltage = 98;
inline constexpr std::uint32_t kLimitCurrent = 99;
inline constexpr std::uint32_t kLimitTemperature = 100;
inline constexpr std::uint32_t kLimitMotorTemperature = 101;
inline constexpr std::uint32_t kLimitTorque = 102;
inline constexpr std::uint32_t kLimitBounds = 103;
inline constexpr std::uint32_t kLimitFluxBraking = 104;
inline constexpr std::uint32_t kLimitFieldWeakening = 105;
}  // namespace fault

// True for the code of an active limit: not a fault, the drive continues.
constexpr bool is_limit(std::uint32_t code) LITHE_RT {
  return code >= fault::kLimitVelocity && code <= fault::kLimitFieldWeakening;
}

// A short text without the code; "none" for 0, "unknown" for other codes. Never null.
// Contract: RT · any thread
const char* fault_name(std::uint32_t code) LITHE_RT;
const char* mode_name(Mode mode) LITHE_RT;

}  // namespace lithe::hal::moteus
