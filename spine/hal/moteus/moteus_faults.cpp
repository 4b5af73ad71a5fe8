// SPDX-License-Identifier: Apache-2.0
#include "spine/hal/moteus/moteus_faults.hpp"

#include <array>
#include <cstddef>

namespace lithe::hal::moteus {
namespace {

constexpr std::uint32_t kFirstFault = fault::kCalibration;
constexpr std::array kFaults{"calibration failed",
                             "gate driver fault",
                             "over-voltage",
                             "encoder fault",
                             "motor not configured",
                             "control loop overran its PWM cycle",
                             "over-temperature",
                             "started outside its position bounds",
                             "under-voltage",
                             "configuration changed while driving",
                             "no valid commutation angle",
                             "no valid position",
                             "gate driver could not be enabled",
                             "stop position together with velocity or acceleration limit",
                             "control timing violated",
                             "back-EMF feedforward without acceleration limit",
                             "invalid limits",
                             "position error too large",
                             "velocity error too large"};

constexpr std::uint32_t kFirstLimit = fault::kLimitVelocity;
constexpr std::array kLimits{
    "velocity limit",          "power limit",  "voltage limit",   "current limit", "temperature limit",
    "motor temperature limit", "torque limit", "position bounds", "flux braking",  "field weakening"};

constexpr std::array kModes{"stopped",  "fault",   "enabling",      "calibrating", "calibration complete",
                            "pwm",      "voltage", "voltage foc",   "voltage dq",  "current",
                            "position", "timeout", "zero velocity", "stay within", "measure inductance",
                            "brake"};

}  // namespace

const char* fault_name(std::uint32_t code) LITHE_RT {
  if (code == 0) return "none";
  if (code >= kFirstFault && code - kFirstFault < kFaults.size()) return kFaults[code - kFirstFault];
  if (code >= kFirstLimit && code - kFirstLimit < kLimits.size()) return kLimits[code - kFirstLimit];
  return "unknown";
}

const char* mode_name(Mode mode) LITHE_RT {
  const auto index = static_cast<std::size_t>(mode);
  return index < kModes.size() ? kModes[index] : "unknown";
}

}  // namespace lithe::hal::moteus
