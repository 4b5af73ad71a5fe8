// SPDX-License-Identifier: Apache-2.0
// Codes of a moteus's fault register, and their names.
#pragma once

#include <cstdint>

#include "spine/core/rt.hpp"
#include "spine/hal/moteus/moteus_codec.hpp"

namespace lithe::hal::moteus {

// Those that are used by name; moteus_faults.cpp has the texts of all.
namespace fault {
inline constexpr std::uint32_t kCalibration = 32;
inline constexpr std::uint32_t kDriver = 33;
inline constexpr std::uint32_t kEncoder = 35;
inline constexpr std::uint32_t kOverTemperature = 38;
inline constexpr std::uint32_t kOutsideLimit = 39;
inline constexpr std::uint32_t kStopPosition = 45;
inline constexpr std::uint32_t kLimitVelocity = 96;
inline constexpr std::uint32_t kLimitTemperature = 100;
inline constexpr std::uint32_t kLimitTorque = 102;
inline constexpr std::uint32_t kLimitBounds = 103;
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
